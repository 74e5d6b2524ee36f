"""One process at a time works on something."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import pytest

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.system.cache import locked


def test_one_command_at_a_time(tmp_path: Path) -> None:
    """A second rigel on the same cluster is refused; the lock leaves nothing."""
    path = tmp_path / "locks" / "cluster a.lock"
    with (
        locked(path, wait=False),
        pytest.raises(RigelK8sError, match="another rigel process works on cluster a"),
        locked(path, wait=False),
    ):
        pass
    assert not path.parent.exists()


def count(path: Path, counter: Path, times: int) -> None:
    """Add one to a number in a file, under the lock."""
    for _ in range(times):
        with locked(path):
            counter.write_text(str(int(counter.read_text()) + 1))


def test_a_lock_that_is_taken_away_still_locks(tmp_path: Path) -> None:
    """Although each holder removes the file, no two hold it at once."""
    counter = tmp_path / "counter"
    counter.write_text("0")
    context = multiprocessing.get_context("spawn")
    arguments = (tmp_path / "locks" / "a.lock", counter, 40)
    workers = [context.Process(target=count, args=arguments) for _ in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert counter.read_text() == "120"
