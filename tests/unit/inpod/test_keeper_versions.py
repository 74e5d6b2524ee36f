"""Pods of two versions of rigel, as an update of it leaves them: what their keepers say."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from tests.support.keepers import STOP, WAIT, WORK, Pod, World
from tests.unit.inpod.test_handover import begin, start_soon

Message = dict[str, Any]
#: What a message of a keeper may have, and need not.
OPTIONAL = [
    ("state", "hears"),
    ("state", "doubled"),
    ("goals", "inside"),
    ("hold", "inside"),
    ("drained", "left"),
]
#: What it must have, where the other one needs it: which pod sends it, its type, its key.
NEEDED = [
    *((0, "state", key) for key in ("matched", "friends", "others", "nodes")),
    *((0, "hello", "worker"), (0, "go", "actions"), (0, "draining", "newest")),
    *((0, "stopped", key) for key in ("newest", "goals", "late")),
    *((1, "goals", "dropped"), (1, "hold", "dropped")),
]


@pytest.fixture
def handover(script: Callable[[str], ModuleType]) -> ModuleType:
    """The protocol."""
    return script("handover")


def without(kind: str, key: str) -> Callable[[Message], Message]:
    """Return how a version says it that does not know a key."""
    return lambda said: {k: v for k, v in said.items() if (said["type"], k) != (kind, key)}


def update(code: ModuleType, version: Callable[[Message], Message | None], *of: int) -> World:
    """Begin an update from one pod to another; those of these numbers have another version."""
    world = begin(code, 1, actions=True)
    start_soon(world)
    for number in of:
        world.pods[number].version = version
    return world


def pair(world: World) -> tuple[Pod, Pod]:
    """Return the old pod and the new one."""
    old, new = world.pods
    return old, new


@pytest.mark.parametrize("of", [(0,), (1,), (0, 1)])
@pytest.mark.parametrize(("kind", "key"), OPTIONAL)
def test_a_key_may_be_missing(
    handover: ModuleType, kind: str, key: str, of: tuple[int, ...]
) -> None:
    """The old pod, or the new one, is of a version before it: nothing is lost or done twice."""
    world = update(handover, without(kind, key), *of)
    world.run(60.0)
    world.judge()
    assert pair(world)[1].lines[-1].startswith("works, took over from pod-0 in ")


@pytest.mark.parametrize("of", [(0,), (1,), (0, 1)])
def test_a_key_may_be_unknown(handover: ModuleType, of: tuple[int, ...]) -> None:
    """A later version may say more."""
    world = update(handover, lambda said: {**said, "later": [{"a": None}]}, *of)
    world.run(60.0)
    world.judge()
    assert pair(world)[1].lines[-1].startswith("works, took over from pod-0 in ")


@pytest.mark.parametrize("number", [{}, {"number": 1}, {"number": 99}])
def test_a_message_may_be_unknown(handover: ModuleType, number: Message) -> None:
    """Also while a switch has that number."""
    world = update(handover, lambda said: said)

    def say() -> None:
        for pod in world.pods:
            for link in pod.links:
                link.send(pod, {"type": "later", **number})
        world.after(0.05, say)

    world.after(0.5, say)  # they know each other
    world.run(60.0)
    world.judge()
    assert pair(world)[1].lines[-1].startswith("works, took over from pod-0 in ")


@pytest.mark.parametrize(("of", "kind", "key"), NEEDED)
def test_what_cannot_be_read_ends_the_old_pods_work(
    handover: ModuleType, of: int, kind: str, key: str
) -> None:
    """As without a hand-over: the new one works at once, once, and says why; nothing hangs."""
    world = update(handover, without(kind, key), of)
    world.exact = False
    world.run(30.0)
    old, new = pair(world)
    assert (new.node.mode, old.node.mode in (STOP, WAIT)) == (WORK, True)
    line = "works, in place of pod-0, whose keeper is of another version of rigel: "
    assert new.lines[-1] == line + "messages may be lost, or handled twice"
    assert len([one for one in (*old.lines, *new.lines) if one.startswith("works")]) == 2


@pytest.mark.parametrize("key", ["friends", "others"])
def test_a_manager_reaches_its_nodes_beside_a_pod_of_another_version(
    handover: ModuleType, key: str
) -> None:
    """A lifecycle manager waits until the other pod leaves its requests alone: here, for ever."""
    world = update(handover, without("state", key), 0)
    world.exact = False
    noted: list[list[str]] = []
    node = pair(world)[1].node
    node.friends = lambda: ["aa"]  # type: ignore[method-assign]
    node.set_known = noted.append  # type: ignore[method-assign,assignment]
    world.run(6.0)
    assert noted == [["aa"]]


def test_what_is_never_answered_ends_the_old_pods_work(handover: ModuleType) -> None:
    """After three attempts: a keeper may get no processor time for a while."""
    world = update(handover, lambda said: None if said["type"] == "go" else said, 0)
    world.exact = False
    world.run(30.0)
    old, new = pair(world)
    assert (old.node.mode, new.node.mode) == (WORK, WAIT)
    world.run(60.0)
    assert (old.node.mode in (STOP, WAIT), new.node.mode) == (True, WORK)
    assert new.lines[-1].startswith("works, in place of pod-0")
