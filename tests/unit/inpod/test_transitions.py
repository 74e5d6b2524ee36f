"""Which transitions a lifecycle node makes at its start and end, and what is said of failures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import attrs
import pytest


class Waiting(Exception):
    """The script waits for longer than the test."""


@attrs.define
class Node:
    """A lifecycle node; the time goes on where someone waits.

    Attributes:
        state: None while it is not there; refusals: by transition, how often it is refused.
        appears: when it is there, unconfigured.
        asked: the transitions that were asked for.
    """

    state: str | None = "unconfigured"
    refusals: dict[str, int] = attrs.field(factory=dict)
    appears: float = 0.0
    goals: dict[str, str] = attrs.field(factory=dict)
    asked: list[str] = attrs.field(factory=list)
    now: float = 0.0
    closed: bool = False

    def hand(self) -> SimpleNamespace:
        """Return what stands for a ROS node that asks it."""
        return SimpleNamespace(
            state=self.look, change=self.change, spin=self.wait, close=self.close
        )

    def look(self) -> str | None:
        if self.state is None and self.appears and self.now >= self.appears:
            self.state = "unconfigured"
        return self.state

    def change(self, transition: str, seconds: float) -> bool:
        assert seconds > 0
        self.asked.append(transition)
        if self.refusals.get(transition, 0) > 0:
            self.refusals[transition] -= 1
            return False
        self.state = self.goals[transition]
        return True

    def wait(self, seconds: float) -> None:
        self.now += max(seconds, 0.001)
        if self.now > 120:
            raise Waiting

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def transitions(
    script: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> ModuleType:
    """The script, whose progress is in a file of the test's own."""
    monkeypatch.setattr(script("progress"), "FILES", (str(tmp_path / "progress"),))
    made = script("transitions")
    monkeypatch.setattr(made, "signal", SimpleNamespace(SIGINT=2, SIGTERM=15, signal=lambda *_: 0))
    return made


@pytest.fixture
def node(transitions: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Node:
    made = Node(goals=transitions.GOALS)
    monkeypatch.setattr(transitions, "time", SimpleNamespace(time=lambda: made.now))
    monkeypatch.setattr(transitions, "Hand", lambda name: made.hand())
    return made


def start(transitions: ModuleType, *words: str) -> None:
    transitions.main(["start", "/talker", *words])


def found(script: Callable[[str], ModuleType]) -> tuple[bool, str]:
    """What the probe finds."""
    ready, line = script("progress").describe("transitions.py", "/talker")
    return bool(ready), str(line)


def test_the_transitions_are_made_in_order(
    transitions: ModuleType, node: Node, script: Callable[[str], ModuleType]
) -> None:
    """The pod is ready in the state that the last one leads to."""
    node.state, node.appears = None, 10.0
    start(transitions, "configure", "activate")
    assert node.asked == ["configure", "activate"]
    assert found(script) == (True, "/talker is active")
    assert node.closed


def test_a_node_that_is_to_stay_inactive_is_ready_then(
    transitions: ModuleType, node: Node, script: Callable[[str], ModuleType]
) -> None:
    start(transitions, "configure")
    assert node.asked == ["configure"]
    assert found(script) == (True, "/talker is inactive")


@pytest.mark.parametrize(("state", "asked"), [("active", []), ("inactive", ["activate"])])
def test_what_a_node_has_done_itself_is_left_out(
    transitions: ModuleType, node: Node, state: str, asked: list[str]
) -> None:
    """A node may configure or activate itself."""
    node.state = state
    start(transitions, "configure", "activate")
    assert node.asked == asked


def test_a_transition_that_fails_is_the_cause_and_tried_again(
    transitions: ModuleType,
    node: Node,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Those before it are not made twice."""
    node.refusals["activate"] = 2
    start(transitions, "configure", "activate")
    assert node.asked == ["configure", "activate", "activate", "activate"]
    log = capsys.readouterr().out
    line = "/talker is inactive and has refused to activate (attempt {}); see its log\n"
    assert line.format(1) in log
    assert line.format(2) in log


def test_a_node_that_always_refuses_is_never_ready(
    transitions: ModuleType, node: Node, script: Callable[[str], ModuleType]
) -> None:
    node.refusals["configure"] = 1000
    with pytest.raises(Waiting):
        start(transitions, "configure", "activate")
    ready, line = found(script)
    assert not ready
    assert line.startswith("/talker is unconfigured and has refused to configure (attempt ")


def test_an_error_in_activate_begins_at_the_front(transitions: ModuleType, node: Node) -> None:
    """Such a node cleans itself up, and has to be configured anew."""
    change = node.change

    def fail_once(transition: str, seconds: float) -> bool:
        if transition == "activate" and node.asked.count("activate") == 0:
            node.asked.append(transition)
            node.state = "unconfigured"
            return False
        return change(transition, seconds)

    hand = node.hand()
    hand.change = fail_once
    transitions.Mover("/talker", ["configure", "activate"], hand).start()
    assert node.asked == ["configure", "activate", "configure", "activate"]


def test_a_node_without_a_lifecycle_says_so(
    transitions: ModuleType, node: Node, script: Callable[[str], ModuleType]
) -> None:
    node.state = None
    with pytest.raises(Waiting):
        start(transitions, "configure")
    line = "/talker offers no lifecycle services: `lifecycle` is for lifecycle nodes"
    assert found(script) == (False, line)


def test_at_the_end_each_is_tried_once(
    transitions: ModuleType,
    node: Node,
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What still starts the node is ended before, since it would undo that."""
    ended: list[int] = []
    monkeypatch.setattr(transitions, "end", ended.append)
    script("progress").Progress("failed", "", pid=77).save()
    node.state, node.refusals = "active", {"cleanup": 1}
    transitions.main(["stop", "4", "/talker", "deactivate", "cleanup", "shutdown"])
    assert node.asked == ["deactivate", "cleanup", "shutdown"]
    assert ended == [77]
    script("progress").Progress("done", "", pid=78).save()
    transitions.main(["stop", "4", "/talker", "deactivate"])
    assert ended == [77], "its number may belong to another process by now"
    assert node.closed
