"""What a master that starts again gets; in virtual time."""

from __future__ import annotations

import asyncio
import json

import pytest

from rigel_gate.calls import Answer, Call, call_of
from rigel_gate.links import MasterGone
from rigel_gate.registry import PUBLISHER, Registration
from tests.support.gate_stage import (
    ASK,
    CHATTER,
    LISTENER,
    ROSOUT,
    TALKER,
    describe,
    fail_always,
    fail_once,
    look_up,
    note_calls,
    owner,
    play,
    publishers,
    up,
)
from tests.support.gate_world import World


@play
async def test_a_new_master_gets_everything_back(world: World) -> None:
    """Registrations and parameters; who looks it up waits and sees no half of it."""
    talker, listener = await up(world, TALKER), await up(world, LISTENER)
    await world.call(Call("setParam", ("/tool", "/robot", {"name": "rosie", "size": {"x": 1}})))
    await world.call(Call("setParam", ("/tool", "/flat", 1)))
    await world.call(Call("deleteParam", ("/tool", "/flat")))
    world.kill_master()
    found = asyncio.ensure_future(look_up(world))
    await asyncio.sleep(3)
    assert not found.done()
    world.start_master()
    assert (await found).is_success
    master = world.master_now
    assert master is not None
    for node in (talker.nodes[0], listener.nodes[0]):
        assert all((node.name, node.api) in master.registered[entry] for entry in node.plan)
    assert master.parameters.tree == {
        "run_id": "run 2",
        "robot": {"name": "rosie", "size": {"x": 1}},
    }
    assert listener.nodes[0].heard["/chatter"] == [talker.nodes[0].api]
    assert (await describe(world))["restarts"] == 1


@play
async def test_nodes_of_another_release_get_everything_back(world: World) -> None:
    """They came by the door of nodes that do not hand over, as those with a `ros_master_uri`."""
    pods = await up(world, TALKER, None), await up(world, LISTENER, None)
    world.kill_master()
    world.start_master()
    assert (await look_up(world)).is_success
    master = world.master_now
    assert master is not None
    for node in (pods[0].nodes[0], pods[1].nodes[0]):
        assert all((node.name, node.api) in master.registered[entry] for entry in node.plan)


@play
async def test_a_master_that_ends_idle_connections_is_no_new_one(world: World) -> None:
    """Every few seconds where roscore has a timeout: no call waits, or is refused, for that."""
    await up(world, TALKER)
    calls = note_calls(world)
    for _ in range(3):
        world.hang_up()
        await asyncio.sleep(0.001)
        assert world.gate is not None
        tool = Call("lookupNode", ("/tool", "/talker"))
        assert (await world.gate.answer(tool, hands_over=False, host="127.0.0.1")).is_success
        await asyncio.sleep(0.2)
    assert {call.method for call in calls} == {"getParam", "lookupNode"}
    assert not [line for line in world.log if "the master is unreachable" in line]


@play
async def test_a_gate_without_a_master_says_so(world: World) -> None:
    """At once: whoever looks why nothing works does not wait for the master."""
    await up(world, TALKER)
    assert (await describe(world))["has_master"]
    world.kill_master()
    await asyncio.sleep(0.1)
    assert world.gate is not None
    asked = world.gate.answer(
        Call("rigelDescribeGate", ("/rigel",)), hands_over=False, host="127.0.0.1"
    )
    assert not json.loads((await asyncio.wait_for(asked, 0.1)).result)["has_master"]
    world.start_master()
    await look_up(world)


@play
async def test_a_new_master_learns_publishers_first(world: World) -> None:
    """A subscriber would be told to drop those that are still missing."""
    await up(world, LISTENER)
    await up(world, TALKER)
    calls = note_calls(world)
    world.kill_master()
    world.start_master()
    await look_up(world)
    many = [call.params[0] for call in calls if call.method == "system.multicall"]
    made = [one["methodName"] for some in many for one in some]
    assert made == [
        *["registerPublisher"] * 3,
        "registerService",
        "registerSubscriber",
        "subscribeParam",
    ]


@play
async def test_a_new_master_gets_large_parameters_in_parts(world: World) -> None:
    """One request with all of them would not fit into the gate's memory, twice."""
    for number in range(20):
        name = f"/maps/{number}" if number % 2 else f"/map{number}"
        await world.call(Call("setParam", ("/tool", name, 300_000 * str(number % 10))))
    before, real, sizes = world.master_now, world.master, []

    async def master(call: Call) -> Answer:
        sizes.append(len(call.body))
        return await real(call)

    world.master = master  # type: ignore[method-assign]
    world.kill_master()
    world.start_master()
    await look_up(world)
    assert before is not None
    assert world.master_now is not None
    for name in before.parameters.own():
        assert world.master_now.parameters.get(name) == before.parameters.get(name)
    assert 600_000 < max(sizes) < 1.5 * 2**20
    assert len(sizes) < 20


@play
async def test_a_new_masters_own_parameters_stay(world: World) -> None:
    for key in ("/rosdistro", "/rosversion", "/roslaunch/uris/a", "/run_id"):
        await world.call(Call("setParam", ("/roscore", key, "old")))
    world.kill_master()
    world.start_master()
    await look_up(world)
    assert world.master_now is not None
    assert world.master_now.parameters.tree == {"run_id": "run 2"}


@play
async def test_what_a_new_master_has_already_is_left_alone(world: World) -> None:
    """A value of a parameter that is set there, by roscore's own launch file perhaps."""
    await world.call(Call("setParam", ("/tool", "/robot/name", "old")))
    await world.call(Call("setParam", ("/tool", "/robot/size", 1)))
    world.kill_master()
    world.start_master()
    assert world.master_now is not None
    world.master_now.parameters.set("/robot/name", "new")
    await look_up(world)
    assert world.master_now.parameters.get("/robot") == {"name": "new", "size": 1}


@play
async def test_a_node_that_has_gone_is_not_given_back(world: World) -> None:
    """Who subscribes to it gets a list without it."""
    talker, camera = await up(world, TALKER), await up(world, {"/camera": [ROSOUT, CHATTER]})
    node = (await up(world, LISTENER)).nodes[0]
    world.kill_master()
    talker.nodes[0].end()
    world.start_master()
    assert not (await look_up(world)).is_success
    await asyncio.sleep(0.1)
    assert publishers(world, "/chatter") == node.heard["/chatter"] == [camera.nodes[0].api]
    assert owner(world, "/talker") is None


@play
async def test_another_process_at_a_nodes_address_is_not_the_node(world: World) -> None:
    """It has other topics."""
    node = (await up(world, TALKER)).nodes[0]
    world.kill_master()
    node.offers = {ROSOUT, (PUBLISHER, "/something else")}
    world.start_master()
    await look_up(world)
    assert owner(world, "/talker") is None


@play
async def test_what_a_node_registers_once_more_is_its_own_again(world: World) -> None:
    """It had taken the topic back for a while: a process without the topic is not the node."""
    node = (await up(world, TALKER)).nodes[0]
    await node.unregister(CHATTER)
    await node.register(*CHATTER)
    node.offers = {ROSOUT, (PUBLISHER, "/something else")}
    world.kill_master()
    world.start_master()
    assert not (await look_up(world)).is_success


@play
async def test_a_node_that_stops_to_publish_while_the_master_is_away_is_the_node(
    world: World,
) -> None:
    """It answers without the topic, before its call has reached the master."""
    node = (await up(world, TALKER)).nodes[0]
    camera = (await up(world, {"/camera": [ROSOUT, CHATTER, (PUBLISHER, "/image")]})).nodes[0]
    world.kill_master()
    stopping = asyncio.ensure_future(node.unregister(CHATTER))
    camera.offers.discard(CHATTER)  # its call is on its way to the gate
    await asyncio.sleep(1)
    world.start_master()
    await stopping
    assert owner(world, "/talker") == node.api
    assert owner(world, "/camera") == camera.api
    assert node.api not in publishers(world, "/chatter")
    assert (await look_up(world)).is_success


@play
async def test_a_silent_node_is_registered_when_it_answers_again(world: World) -> None:
    """Also when the master starts once more meanwhile."""
    lost, other = await up(world, TALKER), await up(world, {"/camera": [ROSOUT, CHATTER]})
    node = (await up(world, LISTENER)).nodes[0]
    world.unreachable.add(lost.host)
    for _ in range(2):
        world.kill_master()
        world.start_master()
        await asyncio.sleep(8)
        assert publishers(world, "/chatter") == [other.nodes[0].api]
        assert (await describe(world))["silent"] == ["/talker"]
    world.unreachable.discard(lost.host)
    calls = note_calls(world)
    await asyncio.sleep(7)
    made = [call.method for call in calls if call.method.startswith("register")]
    assert made == ["registerPublisher", "registerPublisher", "registerService"]
    assert set(publishers(world, "/chatter")) == {lost.nodes[0].api, other.nodes[0].api}
    assert set(node.heard["/chatter"]) == set(publishers(world, "/chatter"))
    assert (await look_up(world)).is_success
    assert (await describe(world))["silent"] == []


@play
async def test_a_silent_node_answers_as_the_master_starts_once_more(world: World) -> None:
    """The next master gets also what the one before it was given."""
    lost = await up(world, TALKER)
    world.unreachable.add(lost.host)
    world.kill_master()
    world.start_master()
    await asyncio.sleep(8)
    real = world.master

    async def master(call: Call) -> Answer:
        answer = await real(call)
        if call.method == "registerPublisher":
            world.master = real  # type: ignore[method-assign]
            world.kill_master()
            await asyncio.sleep(0.1)
            world.start_master()
        return answer

    world.master = master  # type: ignore[method-assign]
    world.unreachable.discard(lost.host)
    await asyncio.sleep(8)
    for topic in ("/rosout", "/chatter"):
        assert publishers(world, topic) == [lost.nodes[0].api]
    assert (await look_up(world)).is_success


@play
async def test_a_silent_node_delays_no_one_when_a_connection_ends(world: World) -> None:
    """The master has not started again: it lacks nothing that it could be given."""
    await up(world, LISTENER)
    lost = await up(world, TALKER)
    world.unreachable.add(lost.host)
    world.kill_master()
    world.start_master()
    await asyncio.sleep(8)
    world.ended.set()
    world.ended = asyncio.Event()
    await asyncio.sleep(0.01)
    started = world.now()
    await world.call(Call("setParam", ("/tool", "/rate", 1)))
    assert world.now() - started < 1
    assert (await describe(world))["restarts"] == 1


@play
async def test_a_silent_node_is_not_forgotten_with_the_gate(world: World) -> None:
    """The next gate finds a master that does not know the node, and must not believe it here."""
    lost = await up(world, TALKER)
    world.unreachable.add(lost.host)
    world.kill_master()
    world.start_master()
    await asyncio.sleep(8)
    await world.kill_gate()
    world.start_gate()
    await asyncio.sleep(8)
    world.unreachable.discard(lost.host)
    await asyncio.sleep(8)
    assert (await look_up(world)).is_success


@play
async def test_a_silent_node_that_has_gone_is_forgotten(world: World) -> None:
    """Its machine is back, without it: who subscribes to it gets a list without it."""
    lost = await up(world, TALKER)
    node = (await up(world, LISTENER)).nodes[0]
    world.unreachable.add(lost.host)
    world.kill_master()
    world.start_master()
    await asyncio.sleep(8)
    assert node.heard["/chatter"] == [lost.nodes[0].api]
    lost.nodes[0].end()
    world.unreachable.discard(lost.host)
    await asyncio.sleep(8)
    assert node.heard["/chatter"] == []
    assert (await describe(world))["silent"] == []


@play
async def test_a_master_that_goes_again_gets_everything_as_well(world: World) -> None:
    """It ends in the middle of being told, or between two calls."""
    talker = await up(world, TALKER)
    await up(world, {f"/n{n}": [(PUBLISHER, f"/t{n}")] for n in range(200)})
    for pause in (0.02, 0.03, 0.05):
        world.kill_master()
        world.start_master()
        await asyncio.sleep(pause)
    world.kill_master()
    world.start_master()
    await look_up(world)
    assert world.master_now is not None
    assert len(world.master_now.nodes) == 201
    assert owner(world, "/talker") == talker.nodes[0].api


@play
async def test_a_call_whose_connection_ends_is_made_again(world: World) -> None:
    """The caller does not notice that the gate had to connect once more."""
    talker = await up(world, TALKER)
    fail_once(world, "lookupService", MasterGone("reset"))
    assert (await look_up(world)).result == talker.nodes[0].detail(*ASK)
    assert not [line for line in world.log if "the master is unreachable" in line], (
        "for that, the master is not gone"
    )


@play
async def test_a_call_from_this_pod_does_not_wait_for_the_master(world: World) -> None:
    """It may be roscore's own, which looks whether a master is there before it starts one."""
    assert world.gate is not None
    call = Call("getPid", ("/roscore",))
    assert (await world.call(Call("getParam", ("/tool", "/run_id")))).result == "run 1"
    local = await world.gate.answer(
        Call("getParam", ("/x", "/run_id")), hands_over=False, host="127.0.0.1"
    )
    assert local.result == "run 1"
    world.kill_master()
    await asyncio.sleep(0.1)
    started = world.now()
    answer = await world.gate.answer(call, hands_over=False, host="127.0.0.1")
    assert world.now() == started
    assert not answer.is_success
    assert b"<fault>" in answer.body


@play
async def test_a_call_from_this_pod_waits_while_a_connection_is_looked_at(world: World) -> None:
    """The master is there, though a connection has ended: also after it was away once."""
    await up(world, TALKER)
    for _ in range(2):
        world.hang_up()
        await asyncio.sleep(0)
        assert world.gate is not None
        call = Call("lookupService", ("/tool", "/talker/ask"))
        assert (await world.gate.answer(call, hands_over=False, host="127.0.0.1")).is_success
        world.kill_master()
        await asyncio.sleep(1)
        world.start_master()
        await look_up(world)
    assert len([line for line in world.log if "the master is unreachable" in line]) == 2


@play
async def test_a_fault_while_a_master_is_completed_is_survived(world: World) -> None:
    """The gate logs it and tries again: else it would wait for the master for ever."""
    await up(world, TALKER)
    fail_once(world, "getParamNames", RuntimeError("unexpected"))
    world.kill_master()
    world.start_master()
    assert (await asyncio.wait_for(look_up(world), 60)).is_success
    why = "the new master cannot be given its registrations: RuntimeError('unexpected')"
    world.log.remove(f"error: {why}")
    assert (await describe(world))["blocked"] == "", "it has succeeded since"


@play
async def test_what_keeps_calls_waiting_is_described(world: World) -> None:
    """A fault that stays: `rigel status` shows it while every call waits."""
    await up(world, TALKER)
    fail_always(world, "getParamNames", RuntimeError("unexpected"))
    world.kill_master()
    world.start_master()
    await asyncio.sleep(5)
    why = (await describe(world))["blocked"]
    assert why == "the new master cannot be given its registrations: RuntimeError('unexpected')"
    world.log[:] = [line for line in world.log if why not in line]


@pytest.mark.parametrize("bad", [OverflowError("port"), UnicodeError("label"), RuntimeError("bug")])
def test_one_bad_node_concerns_itself_alone(bad: Exception):
    """Whatever the look at it raises, the others are registered again, and calls go on."""

    async def story(world: World) -> None:
        talker = await up(world, TALKER)
        lost = (PUBLISHER, "/t", "/evil", "http://10.0.0.1:99999/", "t/T")
        assert (await world.call(call_of(Registration(*lost)))).is_success
        real = world.node

        async def node(api: str, call: Call, seconds: float) -> Answer:
            if "99999" in api:
                raise bad
            return await real(api, call, seconds)

        world.node = node  # type: ignore[method-assign]
        world.kill_master()
        world.start_master()
        assert (await asyncio.wait_for(look_up(world), 60)).is_success
        assert owner(world, "/talker") == talker.nodes[0].api
        assert owner(world, "/evil") is None
        [line] = [line for line in world.log if "error" in line]
        assert line.startswith("error: /evil at http://10.0.0.1:99999/: ")
        world.log.remove(line)

    play(story)()


@play
async def test_what_a_new_master_refuses_is_named(world: World) -> None:
    """One that spoils its request keeps no other one away, and `rigel status` names it."""
    talker = await up(world, TALKER)
    await world.call(Call("setParam", ("/tool", "/robot", 1)))
    real = world.master

    async def master(call: Call) -> Answer:
        if call.method == "system.multicall" and b">/talker/ask<" in call.body:
            return Answer([-1, "not XML", 0])
        return await real(call)

    world.master = master  # type: ignore[method-assign]
    world.kill_master()
    world.start_master()
    await asyncio.sleep(5)
    assert world.master_now is not None
    node = talker.nodes[0]
    assert (node.name, node.api) in world.master_now.registered[CHATTER]
    assert (await describe(world))["refused"] == [
        f"service /talker/ask of /talker at {node.api}: [-1, 'not XML', 0]"
    ]


@play
async def test_a_users_value_replaces_the_default_of_a_new_roscore(world: World) -> None:
    """roscore.py sets this parameter, so it is never missing."""
    await up(world, TALKER)
    name = "/rosout_disable_topics_generation"
    await world.call(Call("setParam", ("/tool", name, True)))
    world.kill_master()
    world.start_master()
    assert world.master_now is not None
    world.master_now.parameters.set(name, False)
    assert (await look_up(world)).is_success
    assert world.master_now.parameters.get(name) is True
