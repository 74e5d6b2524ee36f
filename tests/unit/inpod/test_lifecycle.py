"""Which pod's lifecycle node is active, and when: decided by one pod, and by several at once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import attrs
import pytest

import rigel_inpod

SCRIPTS = Path(rigel_inpod.__file__).parent
OLD, OWN, NEW = "t100_talker_old", "t200_talker_own", "t300_talker_new"


@pytest.fixture
def lifecycle(
    script: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> ModuleType:
    """The script, whose progress is in a file of the test's own."""
    made = script("lifecycle")
    places = (str(tmp_path / "missing" / "file"), str(tmp_path / "file"))
    monkeypatch.setattr(script("progress"), "FILES", places)
    return made


@pytest.fixture
def progress(lifecycle: ModuleType, script: Callable[[str], ModuleType]) -> Callable[[], Any]:
    """What the probe finds of it."""
    return lambda: script("progress").describe("lifecycle.py", "/talker")


#: own state, other pods, what is decided, for whom it waits
DECISIONS: list[tuple[str | None, dict[str, str | None], str, str]] = [
    ("unconfigured", {}, "configure", ""),
    ("unconfigured", {OLD: "active"}, "configure", ""),
    ("inactive", {}, "activate", ""),
    ("inactive", {OLD: "active"}, "wait", "talker_old"),
    ("inactive", {OLD: "activating"}, "wait", "talker_old"),
    ("inactive", {OLD: "deactivating"}, "wait", "talker_old"),
    ("inactive", {OLD: None}, "wait", "talker_old"),
    ("inactive", {OLD: "inactive"}, "activate", ""),
    ("inactive", {OLD: "finalized"}, "activate", ""),
    ("inactive", {OLD: "unconfigured"}, "activate", ""),
    ("inactive", {NEW: "inactive"}, "wait", "talker_new"),
    ("inactive", {NEW: "unconfigured"}, "activate", ""),
    ("inactive", {"t150_talker_own": None}, "activate", ""),
    ("inactive", {OLD: None, "t250_talker_old": "unconfigured"}, "activate", ""),
    ("inactive", {OLD: None, "t250_talker_old": "active"}, "wait", "talker_old"),
    ("active", {}, "done", ""),
    ("active", {OLD: "active"}, "done", ""),
    ("finalized", {}, "wait", ""),
    (None, {}, "wait", ""),
]


@pytest.mark.parametrize(("state", "others", "what", "whom"), DECISIONS)
def test_what_is_decided(
    lifecycle: ModuleType,
    state: str | None,
    others: dict[str, str | None],
    what: str,
    whom: str,
):
    """Whoever works, or does not answer, is waited for; of those that wait the newest goes on.

    What is left of a container that has crashed, in this pod or another, is not waited for.
    """
    assert lifecycle.decide(OWN, state, others) == (what, whom)


def test_a_node_of_no_rigel_pod_is_waited_for_but_not_for_ever(lifecycle: ModuleType):
    """It is that of a pod from before the hand-over was asked for, and will end."""
    assert lifecycle.decide(OWN, "inactive", {}, 1, 59.0)[0] == "wait"
    assert lifecycle.decide(OWN, "inactive", {}, 1, 61.0)[0] == "activate"


def test_pods_of_one_second_are_in_one_order(lifecycle: ModuleType):
    """Otherwise both would wait, or neither."""
    first, second = "t200_a", "t200_b"
    found = {
        own: lifecycle.decide(own, "inactive", {other: "inactive"})[0]
        for own, other in ((first, second), (second, first))
    }
    assert sorted(found.values()) == ["activate", "wait"]


class Refused(Exception):
    """A test waits too long."""


@attrs.define
class World:
    """Pods with lifecycle nodes; the time goes on where someone waits.

    Attributes:
        states: token -> the state of a pod's node.
        refusals: how many transitions are refused.
        events: what happens, by time.
        history: (time, token, transition).
    """

    now: float = 1000.0
    states: dict[str, str | None] = attrs.field(factory=dict)
    strangers: int = 0
    refusals: int = 0
    events: dict[float, Callable[[], Any]] = attrs.field(factory=dict)
    history: list[tuple[float, str, str]] = attrs.field(factory=list)

    def pass_time(self, seconds: float) -> None:
        self.now += max(seconds, 0.001)
        for when in [when for when in self.events if when <= self.now]:
            self.events.pop(when)()
        if self.now > 1200:
            raise Refused

    def set(self, token: str, state: str | None) -> Callable[[], None]:
        return lambda: self.states.update({token: state})

    def drop(self, token: str) -> Callable[[], None]:
        return lambda: self.states.pop(token) and None

    def hand(self) -> Any:
        """Return what stands for a ROS node."""

        def change(token: str, transition: str, seconds: float) -> bool:
            self.history.append((self.now, token, transition))
            if self.refusals > 0:
                self.refusals -= 1
                return False
            goal = {"configure": "inactive", "activate": "active", "deactivate": "inactive"}
            self.states[token] = goal[transition]
            return True

        return SimpleNamespace(
            moved=False,
            pods=lambda: set(self.states),
            count=lambda: len(self.states) + self.strangers,
            state=lambda token: self.states.get(token),
            change=change,
            spin=self.pass_time,
        )


@pytest.fixture
def world(lifecycle: ModuleType, monkeypatch: pytest.MonkeyPatch) -> World:
    made = World()
    monkeypatch.setattr(lifecycle, "time", SimpleNamespace(time=lambda: made.now))
    return made


def take(lifecycle: ModuleType, world: World, token: str = OWN) -> None:
    lifecycle.Taker("/talker", token, world.hand()).run()


def times(world: World, transition: str) -> list[float]:
    return [when - 1000 for when, _, what in world.history if what == transition]


def test_the_first_pod_is_active_once_others_would_have_been_heard(
    lifecycle: ModuleType, world: World, progress: Callable[[], Any]
):
    """At its very start a pod has heard no one, whoever is there."""
    world.states[OWN] = "unconfigured"
    take(lifecycle, world)
    assert times(world, "configure")[0] < 0.1
    assert lifecycle.SETTLE < times(world, "activate")[0] < lifecycle.SETTLE + 0.2
    assert progress() == (True, "/talker is active")


def test_a_node_that_starts_late_is_active_at_once(lifecycle: ModuleType, world: World):
    """Others have been heard meanwhile."""
    world.events[1010.0] = world.set(OWN, "unconfigured")
    take(lifecycle, world)
    assert 10 <= times(world, "activate")[0] < 10.2


def test_whoever_has_met_the_old_one_need_not_listen_longer(lifecycle: ModuleType, world: World):
    """A pod that was deleted is deactivated before the new one has started."""
    world.states.update({OWN: "unconfigured", OLD: "active"})
    world.events[1000.5] = world.set(OLD, "inactive")
    take(lifecycle, world)
    assert times(world, "activate")[0] < 0.5 + lifecycle.PAUSE + 0.1 < lifecycle.SETTLE


def test_to_have_met_one_that_does_not_work_is_not_enough(lifecycle: ModuleType, world: World):
    """A pod of an earlier update may hang at its end, and be heard before the one that works."""
    world.states.update({OWN: "unconfigured", "t50_talker_older": "inactive"})
    world.events[1000.0 + lifecycle.SETTLE - 0.5] = world.set(OLD, "active")
    world.events[1020.0] = world.set(OLD, "inactive")
    take(lifecycle, world)
    assert times(world, "activate")[0] >= 20


def test_a_node_gives_way_to_an_older_one_that_it_has_heard_late(
    lifecycle: ModuleType, world: World
):
    """DDS may need longer on a busy machine; then both work for that while, and no longer."""
    world.states[OWN] = "unconfigured"
    world.events[1006.0] = world.set(OLD, "active")
    world.events[1030.0] = world.set(OLD, "inactive")
    take(lifecycle, world)
    first, second = times(world, "activate")
    assert first < 4
    assert 6 <= times(world, "deactivate")[0] < 6.2
    assert 30 <= second <= 30 + lifecycle.PAUSE + 0.1


def test_a_newer_one_gives_way_and_not_the_older(lifecycle: ModuleType, world: World):
    """Otherwise neither would work."""
    world.states[OWN] = "unconfigured"
    world.events[1006.0] = world.set(NEW, "active")
    take(lifecycle, world)
    assert not times(world, "deactivate")


def test_what_a_crash_has_left_is_no_company(lifecycle: ModuleType, world: World):
    """The container that runs again has heard no one but itself."""
    world.states.update({OWN: "unconfigured", "t150_talker_own": None})
    take(lifecycle, world)
    assert lifecycle.SETTLE < times(world, "activate")[0] < lifecycle.SETTLE + 0.2


def test_the_old_one_is_waited_for(
    lifecycle: ModuleType, world: World, progress: Callable[[], Any]
):
    """It is ready as long as it waits, so that Kubernetes ends the old pod."""
    world.states.update({OWN: "unconfigured", OLD: "active"})
    told = []
    world.events[1030.0] = lambda: told.append(progress())
    world.events[1040.0] = world.set(OLD, "inactive")
    take(lifecycle, world)
    assert 40 <= times(world, "activate")[0] <= 40 + lifecycle.PAUSE + 0.1
    assert told == [(True, "/talker is inactive and waits to take over from talker_old")]
    assert world.states == {OWN: "active", OLD: "inactive"}


def test_an_old_one_that_leaves_without_a_word_is_followed_at_once(
    lifecycle: ModuleType, world: World
):
    """DDS shows that it is gone."""
    world.states.update({OWN: "unconfigured", OLD: "active"})
    world.events[1040.0] = world.drop(OLD)
    take(lifecycle, world)
    assert 40 <= times(world, "activate")[0] < 40.2


def test_a_transition_of_anyone_is_looked_at_at_once(lifecycle: ModuleType, world: World):
    """The gap of a hand-over is what this takes."""
    world.states.update({OWN: "unconfigured", OLD: "active"})
    hand = world.hand()

    def deactivate() -> None:
        world.states[OLD] = "inactive"
        hand.moved = True

    world.events[1040.5] = deactivate
    lifecycle.Taker("/talker", OWN, hand).run()
    assert 40.5 <= times(world, "activate")[0] < 40.7


def test_a_node_that_cannot_be_configured_is_not_ready_and_tried_again(
    lifecycle: ModuleType, world: World, progress: Callable[[], Any]
):
    """The old one works on meanwhile."""
    world.states.update({OWN: "unconfigured", OLD: "active"})
    world.refusals = 1000
    with pytest.raises(Refused):
        take(lifecycle, world)
    assert not times(world, "activate")
    assert len(times(world, "configure")) > 10
    ready, line = progress()
    assert not ready
    assert line.startswith("/talker has refused to configure, ")


def test_a_node_that_is_no_lifecycle_node_says_so(
    lifecycle: ModuleType, world: World, progress: Callable[[], Any]
):
    with pytest.raises(Refused):
        take(lifecycle, world)
    line = "/talker offers no lifecycle services: HandOver is for lifecycle nodes"
    assert progress() == (False, line)


def test_what_someone_else_has_activated_is_left_alone(lifecycle: ModuleType, world: World):
    world.states.update({OWN: "active", OLD: "active"})
    take(lifecycle, world)
    assert world.history == []


@pytest.mark.programs
def test_a_hand_over_that_ended_early_is_not_ready(
    lifecycle: ModuleType, progress: Callable[[], Any]
):
    """An image without rclpy, say."""
    assert progress()[0] is False
    lifecycle.Progress("waits", "/talker waits", OWN, os.getpid()).save()
    assert progress() == (True, "/talker waits")
    done = subprocess.Popen([sys.executable, "-S", "-c", ""])
    done.wait()
    lifecycle.Progress("waits", "/talker waits", OWN, done.pid).save()
    line = "lifecycle.py has ended early for /talker; see the log"
    assert progress() == (False, line)


def test_what_an_earlier_container_wrote_does_not_count(
    lifecycle: ModuleType,
    progress: Callable[[], Any],
    monkeypatch: pytest.MonkeyPatch,
    script: Callable[[str], ModuleType],
):
    """A volume may outlive it."""
    lifecycle.Progress("active", "/talker is active", OWN, 0).save()
    assert progress()[0]
    monkeypatch.setattr(script("container"), "started", lambda: "another")
    assert not progress()[0]


@pytest.mark.parametrize(
    ("step", "code", "asked"),
    [
        ("active", 0, ["deactivate"]),
        ("activates", 0, ["deactivate"]),
        ("waits", 1, []),
        ("failed", 1, []),
    ],
)
def test_only_a_node_that_works_is_deactivated(
    lifecycle: ModuleType,
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    step: str,
    code: int,
    asked: list[str],
):
    """A pod that has only waited ends at once, and what waits in it takes over no more."""
    world.states[OWN] = "active"
    closed: list[bool] = []
    hand = world.hand()
    hand.close = lambda: closed.append(True)
    monkeypatch.setattr(lifecycle, "Hand", lambda name: hand)
    ended: list[int] = []
    monkeypatch.setattr(lifecycle, "end", ended.append)
    lifecycle.Progress(step, "", OWN, 77).save()
    assert lifecycle.leave("/talker", 2.0) == code
    assert [what for _, _, what in world.history] == asked
    assert ended == [77]
    assert closed == [True] * len(asked)


@pytest.mark.programs
def test_no_one_waits_any_more_when_the_hook_goes_on(lifecycle: ModuleType):
    """SIGTERM, and SIGKILL where that was not enough."""
    deaf = "import signal; signal.signal(15, signal.SIG_IGN); print(1, flush=True); signal.pause()"
    with subprocess.Popen([sys.executable, "-S", "-c", deaf], stdout=subprocess.PIPE) as waiting:
        assert waiting.stdout is not None
        waiting.stdout.readline()
        lifecycle.end(waiting.pid)
        assert waiting.wait(10) == -9


@pytest.fixture
def wrapped(tmp_path: Path) -> Callable[..., tuple[list[str], list[str]]]:
    """Run lifecycle.sh with a program and a Python that note how they were called."""
    for name in ("lifecycle.sh", "beside.sh"):
        shutil.copy(SCRIPTS / name, tmp_path)
    note = '#!/bin/sh\nprintf "%s\\n" "$$" "$ROS_SUPER_CLIENT" "$RIGEL_K8S_EXEC" "$@" >"{}"\n'
    for name in ("program", "python3"):
        (tmp_path / name).write_text(note.format(tmp_path / f"{name}.txt"))
        (tmp_path / name).chmod(0o755)

    def run(*words: str, **env: str) -> tuple[list[str], list[str]]:
        path = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
        line = ["/bin/sh", str(tmp_path / "lifecycle.sh"), *words]
        with subprocess.Popen(line, env={**path, **env}, stdout=subprocess.PIPE) as process:
            assert process.communicate(timeout=20) == (b"", None)
            told = [
                (tmp_path / f"{n}.txt").read_text().splitlines() for n in ("program", "python3")
            ]
            assert told[0][0] == str(process.pid), "the program takes the script's place"
        return told[0], told[1]

    return run


@pytest.mark.programs
def test_the_program_gets_services_of_its_own(
    wrapped: Callable[..., tuple[list[str], list[str]]],
):
    """The pod's name is in them, as ROS can spell it; what waits has the same and a mark."""
    words = ["program", "-v", "--ros-args", "-r", "__node:=talker"]
    program, python = wrapped(*words, RIGEL_K8S_POD="talker--5d8-x1")
    token = python[-1]
    seconds, _, pod = token.partition("_")
    assert seconds[0] == "t"
    assert seconds[1:].isdigit()
    assert pod == "talker_5d8_x1"
    own = f"~/_rigel_k8s/{token}"
    assert program[1:] == [
        "",
        "",
        *words[1:],
        *("-r", f"~/change_state:={own}/change_state"),
        *("-r", f"~/get_available_transitions:={own}/get_available_transitions"),
    ]
    assert python[1:3] == ["", "1"]
    assert python[-2:] == ["take", token]


@pytest.mark.programs
def test_what_waits_hears_of_everyone_from_a_discovery_server(
    wrapped: Callable[..., tuple[list[str], list[str]]],
):
    """A client hears only of those that its own topics concern."""
    program, python = wrapped("program", "--ros-args", ROS_DISCOVERY_SERVER="there:11811")
    assert (program[1], python[1]) == ("", "TRUE")
