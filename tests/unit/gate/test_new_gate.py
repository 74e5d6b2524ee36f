"""What a gate knows that starts again; in virtual time."""

from __future__ import annotations

import asyncio
import json
from collections import Counter

import pytest

from rigel_gate import parameters, restoring
from rigel_gate.calls import Call, call_of
from rigel_gate.registry import SERVICE, Registration
from tests.support.gate_stage import (
    ASK,
    CHATTER,
    LISTENER,
    ROSOUT,
    TALKER,
    describe,
    look_up,
    note_calls,
    owner,
    play,
    publishers,
    registered,
    slow_down,
    start,
    up,
)
from tests.support.gate_world import SimNode, World


@play
async def test_the_next_gate_knows_who_waits(world: World) -> None:
    """And what the pods are, and that one is leaving."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    assert world.gate is not None
    before = list(world.gate.state.events())
    await world.kill_gate()
    world.start_gate()
    assert list(world.gate.state.events()) == before
    await asyncio.sleep(2)
    assert owner(world, "/talker") == old.nodes[0].api
    assert await world.hand_over(old) == ["/talker"]
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_who_still_registers_is_not_ready_for_the_next_gate(world: World) -> None:
    """It does not know when the last registration was."""
    old = await up(world, TALKER)
    new = start(world, {"/talker": [ROSOUT]})
    await registered(new)
    await world.kill_gate()
    await asyncio.sleep(5)
    world.start_gate()
    assert [one[2] for one in await world.describe(new)] == ["busy"]
    started = world.now()
    assert await world.hand_over(old) == ["/talker"]
    assert world.now() - started > 0.9


@play
async def test_the_next_gate_finishes_a_hand_over(world: World) -> None:
    """It was killed after the old node had lost its name: no look-up sees half of the new one."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    calls = note_calls(world)
    world.spawn(world.hand_over(old))
    while not [call for call in calls if call.method == "registerPublisher"]:
        await asyncio.sleep(0.001)
    await asyncio.sleep(0.002)
    await world.kill_gate()
    assert owner(world, "/talker") == new.nodes[0].api
    assert not world.master_now.apis(*ASK)  # type: ignore[union-attr]
    world.start_gate()
    assert (await look_up(world)).result == new.nodes[0].detail(*ASK)
    assert (await describe(world))["waiting"] == []


@play
async def test_a_removal_that_waits_for_the_master_comes_after_the_next_gates_lists(
    world: World,
) -> None:
    """The next gate sends subscribers their publishers; the master's shorter list comes last."""
    await up(world, TALKER)
    ears = (await up(world, LISTENER)).nodes[0]
    camera = (await up(world, {"/camera": [ROSOUT, CHATTER]})).nodes[0]
    world.kill_master()
    await world.kill_gate()
    slow_down(world, "publisherUpdate", 0.3)
    world.start_gate()
    leaving = asyncio.ensure_future(camera.unregister(CHATTER))
    await asyncio.sleep(1)
    world.start_master()
    await leaving
    await asyncio.sleep(1)
    lengths = [len(heard) for _, heard in ears.lists]
    assert lengths[-2:] == [2, 1], lengths


@play
async def test_the_next_gate_believes_a_master_that_lives(world: World) -> None:
    """Nodes came and went, and parameters changed, in calls that it has not seen."""
    gone, other = await up(world, TALKER), await up(world, LISTENER)
    moved = await up(world, {"/camera": [ROSOUT, CHATTER]})
    server = (await up(world, {"/server": [ROSOUT, (SERVICE, "/serve")]})).nodes[0]
    await world.call(Call("setParam", ("/tool", "/old", 1)))
    await world.kill_gate()
    master = world.master_now
    assert master is not None
    node = gone.nodes[0]
    master.answer(Call("unregisterPublisher", (node.name, "/chatter", node.api)))
    uri = server.detail(SERVICE, "/serve")
    master.answer(Call("unregisterService", (server.name, "/serve", uri)))
    late = SimNode(world, other, "/late", 1, [])
    again = SimNode(world, moved, "/camera", 2, [])
    for kind, key, name, api, detail in (
        (*CHATTER, "/late", late.api, "t/T"),
        (SERVICE, "/late/ask", "/late", late.api, "rosrpc://late"),
        (*ROSOUT, "/camera", again.api, "t/T"),
        (*ROSOUT, "/laptop", "http://10.9.9.9:1/", "t/T"),
    ):
        master.answer(call_of(Registration(kind, key, name, api, detail)))
    master.answer(Call("setParam", ("/tool", "/new", 2)))
    master.answer(Call("deleteParam", ("/tool", "/old")))
    world.start_gate()
    await look_up(world)
    assert world.gate is not None
    state = world.gate.state
    known = {(one.kind, one.key, one.node, one.api) for one in state.registry.all()}
    assert (*CHATTER, "/talker", node.api) not in known
    assert (*ASK, "/talker", node.api) in known
    assert (*CHATTER, "/late", late.api) in known
    assert (SERVICE, "/late/ask", "/late", late.api) in known
    assert (SERVICE, "/serve", "/server", server.api) not in known
    assert state.registry.nodes["/late"].hands_over, "others at its address do"
    assert not state.registry.nodes["/laptop"].hands_over
    assert {api for _, _, name, api in known if name == "/camera"} == {again.api}
    assert state.parameters.own() == {"new": 2}
    assert (await describe(world))["restarts"] == 0
    late.offers = {CHATTER}
    world.kill_master()
    world.start_master()
    await look_up(world)
    assert late.api in publishers(world, "/chatter"), "what it has learnt is given back, too"
    found = await world.call(Call("lookupService", ("/tool", "/late/ask")))
    assert found.result == "rosrpc://late"


def test_the_next_gate_reads_many_parameters_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """All at once they would not fit into its memory, and no call would be answered meanwhile."""
    monkeypatch.setattr(restoring, "LARGEST_ANSWER", 1000)
    monkeypatch.setattr(parameters, "PIECE", 1000)
    monkeypatch.setattr(parameters, "SMALL", 100)

    @play
    async def story(world: World) -> None:
        await up(world, TALKER)
        for number in range(10):
            await world.call(Call("setParam", ("/tool", f"/map/{number}", str(number) * 200)))
        await world.call(Call("setParam", ("/tool", "/flags/one", 1)))
        await world.kill_gate()
        master = world.master_now
        assert master is not None
        for change in (
            Call("setParam", ("/tool", "/map/3", "new")),
            Call("setParam", ("/tool", "/flags/one", True)),
            Call("deleteParam", ("/tool", "/map/4")),
        ):
            master.answer(change)
        calls = note_calls(world)
        world.start_gate()
        await look_up(world)
        assert world.gate is not None
        own = world.gate.state.parameters
        assert own.get("/map/3") != "new", "calls are answered before"
        await asyncio.sleep(1)
        assert own.own() == {name: master.parameters.get(name) for name in ("map", "flags")}
        assert own.get("/flags/one") is True, "as 1, it is equal"
        assert "/" not in [call.params[1] for call in calls if call.method == "getParam"]
        changed = Counter(json.loads(line)[1] for line in world.journal if b'["set"' in line)
        assert changed["/map/3"] == 2
        assert changed["/map/5"] == 1, "what has not changed is not written again"

    story()


@play
async def test_the_next_gate_sends_the_publishers_again(world: World) -> None:
    """A subscriber that could not ask a gate that was away may have dropped its connection.

    Also one that hands no name over.
    """
    talker = (await up(world, TALKER)).nodes[0]
    ears = (await up(world, LISTENER, workload=None)).nodes[0]
    for forgotten in ([], world.journal):
        await world.kill_gate()
        forgotten.clear()
        ears.lists.clear()
        world.start_gate()
        await look_up(world)
        await asyncio.sleep(1)
        assert ears.lists == [("/chatter", [talker.api])]


@play
async def test_a_gate_without_a_memory_learns_from_the_master(world: World) -> None:
    """It was put in front of a master that has been running."""
    await world.kill_gate()
    assert world.master_now is not None
    world.journal.clear()
    pod = world.start_pod(None, [], {})
    node = world.start_node(pod, "/talker", [])
    world.master_now.answer(call_of(Registration(*CHATTER, "/talker", node.api, "t/T")))
    world.master_now.answer(Call("setParam", ("/tool", "/rate", 5)))
    world.start_gate()
    await look_up(world)
    assert world.gate is not None
    assert world.gate.state.parameters.own() == {"rate": 5}
    [one] = world.gate.state.registry.all()
    assert one == Registration(*CHATTER, "/talker", node.api, "t/T")


@play
async def test_a_master_and_a_gate_that_both_start_again_lose_nothing(world: World) -> None:
    """Their pod has moved to another machine."""
    talker = await up(world, TALKER)
    await world.call(Call("setParam", ("/tool", "/x", 1)))
    await world.kill_gate()
    world.kill_master()
    world.start_master()
    world.start_gate()
    assert (await look_up(world)).is_success
    assert owner(world, "/talker") == talker.nodes[0].api
    assert (await world.call(Call("getParam", ("/tool", "/x")))).result == 1


@play
async def test_the_gate_learns_late_which_master_it_is(world: World) -> None:
    """roscore sets its number after its master has started."""
    assert world.master_now is not None
    await world.kill_gate()
    world.master_now.parameters.delete("/run_id")
    world.journal.clear()
    world.start_gate()
    await asyncio.sleep(1)
    world.master_now.parameters.set("/run_id", "run 7")
    await asyncio.sleep(1)
    assert world.gate is not None
    assert world.gate.state.run == "run 7"
