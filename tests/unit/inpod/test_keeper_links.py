"""How a keeper finds the other pods, and what it asks of the kernel for its connections."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import rigel_inpod

ROOM = Path(rigel_inpod.__file__).parent


def test_short_messages_are_sent_at_once(script: Callable[[str], ModuleType]) -> None:
    """Else each waits for the acknowledgement of the one before: 40 ms of a switch."""
    with socket.socket() as sock:
        script("keeper").Link(sock, 0.0)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


@pytest.mark.programs
def test_the_name_service_is_asked_without_tables_of_unicode() -> None:
    """Each pod has a keeper, and they are 0.3 MB of it that nothing else needs."""
    program = """import keeper, os, sys
names = keeper.Names("localhost")
names.start()
os.read(names.news, 1)
print(bool(names.addresses), {"stringprep", "unicodedata"} & set(sys.modules))
"""
    line = [sys.executable, "-S", "-E", "-B", "-c", program]
    done = subprocess.run(line, cwd=ROOM, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("True set()\n", "")


@pytest.fixture
def keeper(
    script: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[], Any]]:
    """Begins a keeper in a directory, whose name service does not answer."""

    class Silent(script("keeper").Names):  # type: ignore[misc]
        def run(self) -> None:
            self.error = "Temporary failure in name resolution"

    monkeypatch.setattr(script("keeper"), "Names", Silent)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    environ = {"RIGEL_RMW": str(tmp_path), "RIGEL_K8S_PEERS": "talker-pods", "RIGEL_K8S_POD": "a"}
    with closing_all(lambda: script("keeper").Keeper(environ)) as begin:
        yield begin


@contextmanager
def closing_all(make: Callable[[], Any]) -> Iterator[Callable[[], Any]]:
    """Give a function that makes keepers, whose listeners are closed at the end."""
    made = []

    def begin() -> Any:
        made.append(make())
        return made[-1]

    yield begin
    for one in made:
        for sock in (one.listener, *(link.sock for link in one.links.values())):
            sock.close()


def test_a_new_pod_waits_for_the_name_service(keeper: Callable[[], Any], tmp_path: Path) -> None:
    """It may be slow, and an old pod may work: two at once are worse than a late start."""
    new = keeper()
    for seconds in (1, 3, 25):
        new._look(new.begun + seconds)
        assert not new.settled
    assert "Temporary failure in name resolution" in (tmp_path / "progress").read_text()
    new._look(new.begun + 31)
    assert new.settled


def test_an_address_that_is_no_longer_named_is_not_waited_for(keeper: Callable[[], Any]) -> None:
    """The name service has that of a pod that has gone for some seconds; nothing answers there."""
    new = keeper()
    new.names.addresses = ["127.0.0.8", "127.0.0.9"]
    new._look(new.begun + 3)
    assert not new.settled
    new.names.addresses = ["127.0.0.9"]
    new._look(new.begun + 4)
    assert {link.endpoint[0] for link in new.links.values()} == {"127.0.0.9"}
    new.names.addresses = []
    new._look(new.begun + 5)
    assert new.settled


def test_a_pod_that_was_found_says_what_it_does(keeper: Callable[[], Any], tmp_path: Path) -> None:
    """The others may find it first, and it may even work before its own question is answered."""
    new = keeper()
    new.protocol._work("works, took over from b in 0.01 s", {}, [])
    new._look(new.begun + 3)
    assert "took over from b" in (tmp_path / "progress").read_text()


def test_a_pod_that_has_worked_does_not_wait_for_it(
    keeper: Callable[[], Any], tmp_path: Path
) -> None:
    """A robot that is offline restarts a crashed node at once, though it has no name service."""
    (tmp_path / "keeper.json").write_text('{"born": 1.0, "term": 3}')
    again = keeper()
    again._look(again.begun + 1)
    assert not again.settled
    again._look(again.begun + 3)
    assert again.settled
