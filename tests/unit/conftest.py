"""A cluster in memory that behaves like a real one, a reporter, and a note of started programs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from datetime import date
from pathlib import Path

import pytest

from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Store
from tests.support.recorder import Recorder


@pytest.fixture
def fake() -> FakeCluster:
    """A cluster in memory, with controllers, and the namespace `n`."""
    cluster = FakeCluster(Store(controllers=Controllers()))
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
    cluster.calls.clear()
    return cluster


@pytest.fixture
def report() -> Recorder:
    """A reporter that remembers."""
    return Recorder()


class Today(date):
    """A day that stays: golden files with a distribution do not change when its support ends."""

    @classmethod
    def today(cls) -> Today:
        return cls(2026, 11, 24)


@pytest.fixture(autouse=True)
def today(monkeypatch: pytest.MonkeyPatch) -> None:
    """All distributions of the golden files are supported."""
    monkeypatch.setattr("rigel_k8s.app.checks.application.date", Today)


@pytest.fixture(autouse=True)
def state_home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place for what is remembered, which no other test and no user has."""
    place = tmp_path_factory.mktemp("state")
    monkeypatch.setenv("XDG_STATE_HOME", str(place))
    return place


@pytest.fixture(autouse=True)
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of a common terminal, where there is none (CI) and whatever a user's says."""
    monkeypatch.setenv("TERM", "xterm")
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)


#: The test that runs now and is not marked `programs`; those that started one all the same.
_now: list[str] = []
_unmarked: set[str] = set()


def _note_program(event: str, _: object) -> None:
    if _now and event in ("subprocess.Popen", "os.posix_spawn", "os.fork", "os.forkpty"):
        _unmarked.add(_now[0])


sys.addaudithook(_note_program)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Warn of a test without the mark that starts a program: it does not run everywhere."""
    if not item.get_closest_marker("programs"):
        _now.append(item.nodeid)
    try:
        yield
    finally:
        _now.clear()
    if item.nodeid in _unmarked:
        item.user_properties.append(("unmarked", "starts a program: mark it `programs`"))
