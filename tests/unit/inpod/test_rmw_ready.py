"""What the probe says of the layer's notes: the node itself, its executor, and whose turn it is."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import attrs
import pytest

NS = 10**9


@attrs.define
class Pod:
    """A directory of notes, and the probe that reads it."""

    ready: ModuleType
    progress: ModuleType
    directory: Path
    processes: list[object]

    def look(self, node: str | None = "/talker", *, hands_over: bool = False) -> str:
        try:
            return ", ".join(self.ready.look(str(self.directory), node, hands_over))
        except self.ready.NotReady as why:
            return f"not ready: {why}"

    def reaches(self, step: str, line: str, pid: int = os.getpid()) -> None:
        files = [str(self.directory / "progress")]
        self.progress.Progress(step, line, "", pid, files).save()

    def runs(self, *names: str, waiting: bool = True, still: float = 0, **more: object) -> None:
        """Add a process with nodes of these names, and an executor that turned so long ago."""
        notes = self.ready.rmw_notes
        empty = dict.fromkeys(notes.Entity._fields, 0)
        last = int((time.monotonic() - still) * NS)
        nodes = [notes.Entity(**{**empty, "kind": "node", "name": name}) for name in names]
        own = {"kind": "executor", "name": "", "last": last}
        entities = (*nodes, notes.Entity(**{**empty, **own}))
        fields = {**dict.fromkeys(notes.Process._fields, 0), "pid": 7, "entities": entities}
        fields["stands"] = 0 if waiting else int(still * NS)
        self.processes.append(notes.Process(**{**fields, **more}))


@pytest.fixture
def pod(
    script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Pod:
    made = Pod(script("rmw_ready"), script("progress"), tmp_path / "notes", [])
    made.directory.mkdir()
    monkeypatch.setattr(script("rmw_notes"), "read_all", lambda _: made.processes)
    return made


def test_the_node_of_the_name_must_exist(pod: Pod) -> None:
    """That of another name is what a program has that does not read its arguments."""
    assert pod.look() == "", "a program without ROS is probed as before,"
    missing = "no process has loaded ROS 2; a program without it needs `ros: none`"
    assert pod.look(hands_over=True).endswith(missing), "but cannot be handed over"
    pod.runs()
    assert pod.look() == "not ready: the node /talker does not exist yet"
    pod.runs("/chatter")
    other = "the node /talker does not exist yet; there is /chatter, does it read --ros-args?"
    assert pod.look() == f"not ready: {other}"
    assert pod.look(None) == "/chatter"
    pod.runs("/talker")
    assert pod.look() == "/chatter, /talker"


def test_helpers_of_ours_and_what_has_ended_are_no_nodes(pod: Pod) -> None:
    """Their files stay for a while."""
    pod.runs("/talker", helper=True)
    pod.runs("/talker", ended=True)
    pod.runs()
    assert pod.look() == "not ready: the node /talker does not exist yet"


def test_an_executor_must_turn(pod: Pod) -> None:
    """A callback that does not return in half a minute is a node that hangs."""
    pod.runs("/talker", waiting=False, still=10)
    assert pod.look() == "/talker"
    pod.processes.clear()
    pod.runs("/talker", waiting=False, still=100)
    assert pod.look() == "not ready: /talker hangs: no turn of its executor for 100 s"
    pod.processes.clear()
    pod.runs("/talker", waiting=True, still=1000)
    assert pod.look() == "/talker", "nothing comes, and that is no fault"


def test_a_pod_that_waits_is_not_ready(pod: Pod) -> None:
    """Kubernetes would end the old one. The kind is for whoever waits for the roll-out."""
    pod.runs("/talker")
    assert pod.look(hands_over=True).startswith("not ready: keeper.py has not started yet")
    pod.reaches("standby", "waits to take over from talker-1: /navigate has 1 goal")
    waits = "waits to take over from talker-1: /navigate has 1 goal [waits]"
    assert pod.look(hands_over=True) == f"not ready: {waits}"
    pod.reaches("starts", "looks for other pods")
    assert pod.look(hands_over=True) == "not ready: looks for other pods"
    pod.reaches("works", "took over from talker-1 in 0.04 s")
    assert pod.look(hands_over=True) == "/talker"
    pod.reaches("works", "took over from talker-1 in 0.04 s", pid=2**22 + 1)
    assert "has ended early" in pod.look(hands_over=True)
    assert pod.look() == "/talker", "the keeper does not matter to a pod that hands nothing over"


def test_what_is_wrong_with_a_node_is_not_hidden_by_its_wait(pod: Pod) -> None:
    """Else its roll-out would wait as if the old one were busy, and its cause would be unknown."""
    pod.reaches("standby", "waits to take over from talker-1")
    pod.runs("/chatter")
    assert "the node /talker does not exist yet" in pod.look(hands_over=True)
    pod.runs("/talker", waiting=False, still=100)
    assert "no turn of its executor for 100 s" in pod.look(hands_over=True)


def test_without_the_layer_a_pod_is_probed_as_before_but_not_handed_over(pod: Pod) -> None:
    """Two of it would both work: the reason is that of rmw.sh."""
    (pod.directory / "left-out").write_text("this image has no Python 3\n")
    assert pod.look() == ""
    expected = "not ready: it cannot be handed over: this image has no Python 3"
    assert pod.look(hands_over=True) == expected
    pod.directory = pod.directory / "elsewhere"
    assert pod.look() == ""
    assert "cannot be written" in pod.look(hands_over=True)


def test_a_program_without_ros_is_not_handed_over(pod: Pod) -> None:
    """Nothing would arbitrate between two of it; else it is probed as before."""
    assert pod.look() == ""
    pod.reaches("works", "works")
    assert pod.look(None) == ""
    assert "`ros: none`" in pod.look(None, hands_over=True)
