"""A stage for the gate's single promises: pods that are up, and what the master knows of them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Coroutine
from typing import Any

from rigel_gate.calls import GATE, Answer, Call
from rigel_gate.registry import PARAMETER, PUBLISHER, SERVICE, SUBSCRIBER
from tests.support.gate_world import Plan, SimPod, World, run

ROSOUT = (PUBLISHER, "/rosout")
CHATTER = (PUBLISHER, "/chatter")
HEARS = (SUBSCRIBER, "/chatter")
ASK = (SERVICE, "/talker/ask")
RATE = (PARAMETER, "/rate")
TALKER: dict[str, Plan] = {"/talker": [ROSOUT, CHATTER, ASK]}
LISTENER: dict[str, Plan] = {"/listener": [ROSOUT, HEARS, RATE]}
QUIET = 1.0

Story = Callable[[World], Coroutine[Any, Any, None]]


def play(story: Story) -> Callable[[], None]:
    """Make a test of a story that is told in a world with a master and a gate."""

    def test() -> None:
        async def tell() -> None:
            world = World(0)
            world.start_gate()
            await story(world)
            assert world.broken == []
            assert not [line for line in world.log if "error" in line], world.log

        run(tell)

    test.__name__, test.__doc__ = story.__name__, story.__doc__
    return test


def start(
    world: World, plans: dict[str, Plan], workload: str | None = "app", **more: Any
) -> SimPod:
    return world.start_pod(workload, list(plans), plans, probed=False, **more)


async def up(
    world: World, plans: dict[str, Plan], workload: str | None = "app", **more: Any
) -> SimPod:
    """Start a pod whose nodes have registered everything, and have been quiet."""
    pod = start(world, plans, workload, **more)
    if workload:
        await world.describe(pod)
    await registered(pod)
    await asyncio.sleep(QUIET + 0.1)
    return pod


async def registered(pod: SimPod) -> None:
    while any(node.registered < set(node.plan) for node in pod.nodes):
        await asyncio.sleep(0.01)


def owner(world: World, name: str) -> str | None:
    assert world.master_now is not None
    return world.master_now.nodes.get(name)


def publishers(world: World, topic: str) -> list[str]:
    assert world.master_now is not None
    return world.master_now.apis(PUBLISHER, topic)


async def describe(world: World) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(
        (await world.call(Call("rigelDescribeGate", (GATE,)))).result
    )
    return found


async def look_up(world: World) -> Answer:
    return await world.call(Call("lookupService", ("/tool", "/talker/ask")))


def note_calls(world: World) -> list[Call]:
    """Return a list that gets each call that the master gets."""
    calls, real = [], world.master

    async def master(call: Call) -> Answer:
        calls.append(call)
        return await real(call)

    world.master = master  # type: ignore[method-assign]
    return calls


def slow_down(world: World, method: str, seconds: float) -> None:
    """Let calls of nodes of this method take so long."""
    real = world.node

    async def node(api: str, call: Call, patience: float) -> Answer:
        await asyncio.sleep(seconds if call.method == method else 0)
        return await real(api, call, patience)

    world.node = node  # type: ignore[method-assign]


def fail_always(world: World, method: str, error: Exception) -> None:
    """Let each of the master's calls of this method fail."""
    real = world.master

    async def master(call: Call) -> Answer:
        if call.method == method:
            raise error
        return await real(call)

    world.master = master  # type: ignore[method-assign]


def fail_once(world: World, method: str, error: Exception) -> None:
    """Let the master's next call of this method fail."""
    real = world.master

    async def master(call: Call) -> Answer:
        if call.method == method:
            world.master = real  # type: ignore[method-assign]
            raise error
        return await real(call)

    world.master = master  # type: ignore[method-assign]
