"""Who has a name, and when it changes hands; in virtual time."""

from __future__ import annotations

import asyncio
from unittest.mock import patch

import pytest

from rigel_gate.calls import Answer, BadCall, Call
from rigel_gate.links import NodeSilent
from rigel_gate.memory import replay
from rigel_gate.nodes import STOP
from rigel_gate.registry import PUBLISHER
from rigel_gate.takeover import read_seconds
from tests.support.gate_stage import (
    ASK,
    CHATTER,
    LISTENER,
    QUIET,
    ROSOUT,
    TALKER,
    describe,
    look_up,
    owner,
    play,
    publishers,
    registered,
    start,
    up,
)
from tests.support.gate_world import Plan, SimNode, World

CAMERA: dict[str, Plan] = {"/camera": [ROSOUT, CHATTER]}

# -- who has a name, and when it changes hands --


@play
async def test_a_newcomer_waits_while_the_old_node_lives(world: World) -> None:
    """The master never knows two owners of a name, and the old one works on."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    await asyncio.sleep(60)
    assert old.nodes[0].alive
    assert owner(world, "/talker") == old.nodes[0].api
    assert publishers(world, "/chatter") == [old.nodes[0].api]
    assert [one["api"] for one in (await describe(world))["waiting"]] == [new.nodes[0].api]


@play
async def test_a_pod_that_ends_hands_its_names_over(world: World) -> None:
    """The newcomer has them, with all that it has registered, when the answer comes."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    assert await world.hand_over(old) == ["/talker"]
    node = new.nodes[0]
    assert owner(world, "/talker") == node.api
    assert publishers(world, "/chatter") == publishers(world, "/rosout") == [node.api]
    assert (await look_up(world)).result == node.detail(*ASK)
    await asyncio.sleep(0.1)
    assert not old.nodes[0].alive, "the master shuts it down"
    assert (await describe(world))["waiting"] == []


@play
async def test_a_name_changes_hands_once_the_old_node_has_stopped(world: World) -> None:
    """No one hears both. What the old one unregisters as it stops does not wait for its turn."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    node, started = old.nodes[0], world.now()
    node.lingers = 0.6
    leaving = asyncio.ensure_future(world.hand_over(old))
    await asyncio.sleep(0.5)
    assert node.alive
    assert publishers(world, "/chatter") == [node.api]
    assert await leaving == ["/talker"]
    assert not node.alive
    assert publishers(world, "/chatter") == [new.nodes[0].api]
    assert 0.6 <= world.now() - started < 0.8


@play
async def test_an_old_node_that_stops_without_an_answer_is_asked_again(world: World) -> None:
    """rospy closes its server while a call waits there; the next call is refused."""
    old, _ = await up(world, TALKER), await up(world, TALKER)
    real, unanswered = world.node, 1

    async def node(api: str, call: Call, patience: float) -> Answer:
        nonlocal unanswered
        if call.method == "getPublications" and unanswered:
            unanswered -= 1
            await asyncio.sleep(patience)
            raise NodeSilent("no answer")
        return await real(api, call, patience)

    world.node = node  # type: ignore[method-assign]
    started = world.now()
    assert await world.hand_over(old) == ["/talker"]
    assert not unanswered
    assert world.now() - started < STOP / 4


@play
async def test_an_old_node_that_does_not_stop_is_not_waited_for_long(world: World) -> None:
    old, new = await up(world, TALKER), await up(world, TALKER)
    old.nodes[0].lingers = 60
    started = world.now()
    assert await world.hand_over(old) == ["/talker"]
    assert world.now() - started < STOP + 0.2
    assert owner(world, "/talker") == new.nodes[0].api
    world.broken.clear()  # that both publish is what happens then


@play
async def test_a_name_is_not_handed_over_before_the_newcomer_is_ready(world: World) -> None:
    """It counts as ready a second after its last registration."""
    old = await up(world, TALKER)
    new = start(world, {"/talker": [ROSOUT]})
    await registered(new)
    leaving = asyncio.ensure_future(world.hand_over(old))
    await asyncio.sleep(0.8)
    await new.nodes[0].register(*CHATTER)
    last = world.now()
    await asyncio.sleep(0.8)
    assert owner(world, "/talker") == old.nodes[0].api
    assert await leaving == ["/talker"]
    assert QUIET <= world.now() - last < QUIET + 0.3


@play
async def test_a_newcomer_has_only_so_long_to_become_ready(world: World) -> None:
    """The old pod ends anyway."""
    old = await up(world, TALKER)
    new = start(world, {"/talker": [(PUBLISHER, f"/t{n}") for n in range(100)]})
    await asyncio.sleep(0.5)
    started = world.now()
    assert await world.hand_over(old, seconds=3) == ["/talker"]
    assert 3 <= world.now() - started < 3.5
    assert owner(world, "/talker") == new.nodes[0].api
    await registered(new)


@play
async def test_a_newcomer_that_dies_changes_nothing(world: World) -> None:
    """The old node has its name, and no one is left to take it over."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    new.nodes[0].end()
    await asyncio.sleep(0.5)
    assert (await describe(world))["waiting"] == []
    assert await world.hand_over(old) == []
    assert owner(world, "/talker") == old.nodes[0].api


@play
async def test_a_newcomer_that_dies_while_it_is_waited_for_changes_nothing(world: World) -> None:
    """A hand-over finds out by itself that it has ended."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    new.nodes[0].end()
    assert await world.hand_over(old) == []
    assert old.nodes[0].alive


@play
async def test_the_newcomer_takes_over_at_once_when_the_old_node_dies(world: World) -> None:
    old, new = await up(world, TALKER), await up(world, TALKER)
    old.nodes[0].end()
    await asyncio.sleep(0.4)
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_the_newcomer_takes_over_at_once_when_the_old_node_takes_leave(world: World) -> None:
    """A free name does not wait for the next look."""
    with patch("rigel_gate.gate.LOOK", 1000):
        old, new = await up(world, TALKER), await up(world, TALKER)
    await old.nodes[0].leave()
    await asyncio.sleep(0.05)
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_the_name_of_a_node_that_has_ended_is_free_at_once(world: World) -> None:
    """A newcomer that registers after the old node's end does not wait for a look."""
    with patch("rigel_gate.gate.LOOK", 1000):
        old = await up(world, TALKER)
    old.nodes[0].end()
    new = await up(world, TALKER)
    assert owner(world, "/talker") == new.nodes[0].api
    assert not [line for line in world.log if "waits" in line]


@play
async def test_of_two_that_find_a_name_free_the_first_one_gets_it(world: World) -> None:
    """The other one has looked at a node that does not have the name any more: it waits."""
    old = await up(world, TALKER)
    old.nodes[0].end()
    pods = [world.start_pod("app", [], {}, probed=False) for _ in range(2)]
    nodes = [world.start_node(pod, "/talker", []) for pod in pods]
    await asyncio.gather(*(node.register(*ROSOUT) for node in nodes))
    await asyncio.sleep(5)
    waiting = [one["api"] for one in (await describe(world))["waiting"]]
    assert sorted([str(owner(world, "/talker")), *waiting]) == sorted(node.api for node in nodes)
    assert all(node.alive for node in nodes)


@play
async def test_the_name_of_a_node_that_ended_with_the_master_is_free(world: World) -> None:
    """The new master never learns it; who waits for it gets it at the next look."""
    with patch("rigel_gate.gate.LOOK", 30):
        old, new = await up(world, TALKER), await up(world, TALKER)
    world.kill_master()
    old.nodes[0].end()
    world.start_master()
    await asyncio.sleep(1)
    assert owner(world, "/talker") is None
    await asyncio.sleep(30)
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_a_hand_over_that_is_interrupted_is_finished(world: World) -> None:
    """The newcomer has half of what the old node had, and gets the other half at the next look."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    real = world.master

    async def master(call: Call) -> Answer:
        if call.method == "registerService":
            world.master = real  # type: ignore[method-assign]
            handing.cancel()
        return await real(call)

    world.master = master  # type: ignore[method-assign]
    assert world.gate is not None
    call = Call("rigelHandOver", ("/stop", "10", old.host))
    old.leaving = True
    handing = asyncio.ensure_future(world.gate.answer(call, hands_over=True))
    await asyncio.wait([handing])
    assert handing.cancelled()
    await asyncio.sleep(1)
    assert (await look_up(world)).result == new.nodes[0].detail(*ASK)
    assert (await describe(world))["waiting"] == []


@play
async def test_a_newcomer_that_is_not_ready_inherits_too(world: World) -> None:
    """Half a node is better than none."""
    old, new = await up(world, TALKER), start(world, {"/talker": [ROSOUT, CHATTER, ASK]})
    while not new.nodes[0].registered:
        await asyncio.sleep(0.01)
    old.nodes[0].end()
    await asyncio.sleep(0.4)
    assert owner(world, "/talker") == new.nodes[0].api
    await registered(new)
    assert (await look_up(world)).is_success


@play
async def test_the_name_of_a_machine_that_is_away_is_free(world: World) -> None:
    old, new = await up(world, TALKER), await up(world, TALKER)
    world.unreachable.add(old.host)
    await asyncio.sleep(5)
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_a_node_that_starts_again_in_its_pod_is_no_newcomer(world: World) -> None:
    """It comes from the same address, and has its name at once although another one waits."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    again = world.start_node(old, "/talker", TALKER["/talker"])
    await registered(old)
    await asyncio.sleep(5)
    assert owner(world, "/talker") == again.api
    assert new.nodes[0].alive
    assert not (await describe(world))["conflicts"]


@play
async def test_a_node_that_has_started_again_keeps_its_name(world: World) -> None:
    """Who waits has seen the old process die, but its successor was first."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    real = world.master

    async def master(call: Call) -> Answer:
        await asyncio.sleep(1 if call.method == "setParam" else 0)
        return await real(call)

    world.master = master  # type: ignore[method-assign]
    slow = asyncio.ensure_future(world.call(Call("setParam", ("/tool", "/x", 1))))
    old.nodes[0].end()
    again = SimNode(world, old, "/talker", 1, [])
    await asyncio.gather(slow, again.register(*ROSOUT))
    await asyncio.sleep(5)
    assert again.alive
    assert owner(world, "/talker") == again.api
    assert new.nodes[0].alive


@play
async def test_a_newcomer_that_starts_again_waits_again(world: World) -> None:
    """What its first process had registered is forgotten."""
    old, new = await up(world, TALKER), await up(world, {"/talker": [ROSOUT, (PUBLISHER, "/old")]})
    new.nodes[0].end()
    again = world.start_node(new, "/talker", TALKER["/talker"])
    await asyncio.sleep(3)
    assert [one["api"] for one in (await describe(world))["waiting"]] == [again.api]
    assert await world.hand_over(old) == ["/talker"]
    assert publishers(world, "/old") == []
    assert publishers(world, "/chatter") == [again.api]


@play
async def test_a_newcomer_that_starts_again_replaces_itself(world: World) -> None:
    """Its first process may still be ending: it does not wait beside the second one."""
    await up(world, TALKER)
    new = await up(world, TALKER)
    again = world.start_node(new, "/talker", TALKER["/talker"])
    await registered(new)
    assert [one["api"] for one in (await describe(world))["waiting"]] == [again.api]


@play
async def test_a_newcomer_that_registers_the_same_again_stays_ready(world: World) -> None:
    """rospy subscribes to a parameter with each line that it logs."""
    await up(world, LISTENER)
    new = await up(world, LISTENER)
    before = list(world.journal)
    for entry in new.nodes[0].plan:
        await new.nodes[0].register(*entry)
    assert [state for _, _, state, _ in await world.describe(new)] == ["quiet"]
    assert world.journal == before
    assert len([line for line in world.log if "waits to take over" in line]) == 1


@play
async def test_of_two_newcomers_the_later_one_inherits(world: World) -> None:
    """But not before it is ready where the other one is."""
    old, one = await up(world, TALKER), await up(world, TALKER)
    two = await up(world, TALKER)
    assert await world.hand_over(old) == ["/talker"]
    assert owner(world, "/talker") == two.nodes[0].api
    start(world, {"/talker": [(PUBLISHER, f"/t{n}") for n in range(100)]})
    await asyncio.sleep(0.5)
    assert await world.hand_over(two) == ["/talker"]
    assert owner(world, "/talker") == one.nodes[0].api


@play
async def test_a_pod_that_ends_does_not_inherit(world: World) -> None:
    """A failed update is taken back while its nodes still run."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    assert await world.hand_over(new) == []
    await asyncio.sleep(2)
    old.nodes[0].end()
    await asyncio.sleep(2)
    assert owner(world, "/talker") == old.nodes[0].api, "the next process of its pod will have it"


@play
async def test_a_pod_that_has_ended_is_forgotten(world: World) -> None:
    """Its address is not remembered as one that is about to end, and its description goes."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    await world.end_pod(old)
    await asyncio.sleep(1)
    assert world.gate is not None
    assert world.gate.state.leaving == set()
    assert list(world.gate.state.pods) == [new.host]


@play
async def test_a_pod_that_ends_without_a_hand_over_is_forgotten_later(world: World) -> None:
    """Its probe comes no more, and it has no node; one whose probe comes stays, node or not."""
    killed, empty, busy = (
        await up(world, TALKER),
        await up(world, LISTENER),
        await up(world, CAMERA),
    )
    killed.nodes[0].end()
    await killed.nodes[0].unregister(*TALKER["/talker"])
    await empty.nodes[0].leave()
    assert world.gate is not None
    for _ in range(8):
        assert list(world.gate.state.pods) == [killed.host, empty.host, busy.host]
        await asyncio.sleep(60)
        await world.describe(empty)
    await asyncio.sleep(150)
    assert list(world.gate.state.pods) == [empty.host, busy.host]
    assert replay(world.journal).pods.keys() == {empty.host, busy.host}


@pytest.mark.parametrize("seconds", ["nan", "inf", "-inf", "1e400", "soon", ""])
def test_a_hand_over_ends(seconds: str) -> None:
    """However long a newcomer goes on to register: the time that it has is a number."""

    @play
    async def story(world: World) -> None:
        old = await up(world, TALKER)
        start(world, {"/talker": [(PUBLISHER, f"/t{n}") for n in range(100)]})
        await asyncio.sleep(0.5)
        for host in (old.host, "10.9.9.9"):
            with pytest.raises(BadCall, match="not a number of seconds"):
                await world.call(Call("rigelHandOver", ("/stop", seconds, host)))
        assert world.gate is not None
        assert world.gate.state.leaving == set(), "it has not begun"

    story()


def test_a_hand_over_takes_an_hour_at_most() -> None:
    assert [read_seconds(text) for text in ("0", "2.5", "3601", "1e9")] == [0, 2.5, 3600, 3600]


@play
async def test_a_pod_has_no_more_than_its_addresses(world: World) -> None:
    many = tuple(f"10.7.0.{number}" for number in range(65))
    for words in (("/stop", "1", *many), ("/probe", "pod", "app", *many)):
        method = "rigelHandOver" if len(words) == 67 else "rigelDescribePod"
        with pytest.raises(BadCall, match="a pod has at most 64 addresses"):
            await world.call(Call(method, words))
    assert world.gate is not None
    assert (world.gate.state.pods, world.gate.state.leaving) == ({}, set())


@play
async def test_an_address_may_be_another_pods_later(world: World) -> None:
    """That its first pod has left does not count for the second one."""
    old, gone = await up(world, TALKER), await up(world, TALKER)
    await world.hand_over(gone)
    await world.describe(gone)
    words = ("/probe", "the next pod", "app", "", gone.host)
    await world.call(Call("rigelDescribePod", words))
    assert await world.hand_over(old) == ["/talker"]


@play
async def test_a_newcomer_whose_machine_is_away_waits_on(world: World) -> None:
    """It never registers again by itself; meanwhile it inherits nothing."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    world.unreachable.add(new.host)
    await asyncio.sleep(20)
    assert await world.hand_over(old) == []
    assert owner(world, "/talker") == old.nodes[0].api
    world.unreachable.discard(new.host)
    await asyncio.sleep(5)
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_a_machine_that_is_away_delays_no_one_else(world: World) -> None:
    """The look at its nodes takes seconds, the others are looked at meanwhile."""
    await up(world, LISTENER)
    lost = await up(world, LISTENER)
    old, new = await up(world, TALKER), await up(world, TALKER)
    world.unreachable.add(lost.host)
    await asyncio.sleep(1)
    old.nodes[0].end()
    await asyncio.sleep(0.4)
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_a_machine_that_is_away_is_not_asked_again_before_it_answers(world: World) -> None:
    """A try takes three seconds; else each look would begin one more."""
    await up(world, LISTENER)
    lost = await up(world, LISTENER)
    world.unreachable.add(lost.host)
    real, tries = world.connect, []

    async def connect(api: str, seconds: float) -> None:
        tries.append(api)
        await real(api, seconds)

    world.connect = connect  # type: ignore[method-assign]
    await asyncio.sleep(30)
    assert 8 <= tries.count(lost.nodes[0].api) <= 11


@play
async def test_a_fault_in_a_look_ends_no_hand_over(world: World) -> None:
    """It is logged, and the next look is taken."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    real = world.connect

    async def connect(api: str, seconds: float) -> None:
        world.connect = real  # type: ignore[method-assign]
        raise RuntimeError("in a look at a node")

    world.connect = connect  # type: ignore[method-assign]
    await asyncio.sleep(0.5)
    with patch("rigel_gate.nodes.Nodes.send_again", side_effect=RuntimeError("in a look")):
        await asyncio.sleep(0.3)
    faults = ("in a look at a node", "in a look")
    assert {f"error: RuntimeError('{fault}')" for fault in faults} <= set(world.log)
    world.log.clear()
    old.nodes[0].end()
    await asyncio.sleep(0.5)
    assert owner(world, "/talker") == new.nodes[0].api


@play
async def test_a_call_of_a_process_that_has_ended_takes_no_name(world: World) -> None:
    """It has waited at the gate while the master was away."""
    old = await up(world, TALKER)
    world.kill_master()
    laptop = start(world, TALKER, None)
    await asyncio.sleep(0.5)
    laptop.nodes[0].end()
    world.start_master()
    await asyncio.sleep(5)
    assert old.nodes[0].alive
    assert owner(world, "/talker") == old.nodes[0].api


# -- what is no roll-out --


@play
async def test_a_node_from_elsewhere_gets_its_name_at_once(world: World) -> None:
    """The younger one wins, as in plain ROS, and `rigel` can report it."""
    old = await up(world, TALKER)
    laptop = await up(world, TALKER, None)
    assert owner(world, "/talker") == laptop.nodes[0].api
    assert not old.nodes[0].alive
    [conflict] = (await describe(world))["conflicts"]
    assert conflict["node"] == "/talker"
    assert (conflict["old"], conflict["new"]) == (old.nodes[0].api, laptop.nodes[0].api)
    assert 0 < conflict["time"] < 3


@play
async def test_a_pod_takes_its_name_back_from_elsewhere(world: World) -> None:
    """The younger one wins here too: nothing says that the laptop's node is to stay."""
    await up(world, TALKER, None)
    pod = await up(world, TALKER)
    assert owner(world, "/talker") == pod.nodes[0].api


@play
async def test_another_workloads_node_gets_its_name_at_once(world: World) -> None:
    """Two workloads with nodes of one name are a mistake, and no roll-out."""
    old = await up(world, TALKER, "one")
    new = await up(world, TALKER, "two")
    assert owner(world, "/talker") == new.nodes[0].api
    assert not old.nodes[0].alive
    assert [one["old"] for one in (await describe(world))["conflicts"]] == [old.nodes[0].api]


@play
async def test_another_workloads_node_gets_its_name_when_its_pod_is_known(world: World) -> None:
    """A node may register before the first probe says to which workload it belongs."""
    old = await up(world, TALKER, "one")
    new = start(world, TALKER, "two")
    await registered(new)
    assert owner(world, "/talker") == old.nodes[0].api
    await world.describe(new)
    await asyncio.sleep(0.2)
    assert owner(world, "/talker") == new.nodes[0].api
    assert len((await describe(world))["conflicts"]) == 1


@play
async def test_a_conflict_is_written_down_once(world: World) -> None:
    """Probes see it again and again while the master is away; it has its age in seconds."""
    await up(world, TALKER)
    new = start(world, TALKER, "other")
    await registered(new)
    world.kill_master()
    for _ in range(3):
        await world.describe(new)
    world.start_master()
    await asyncio.sleep(60)
    [conflict] = (await describe(world))["conflicts"]
    assert conflict["new"] == new.nodes[0].api
    assert 60 <= conflict["time"] < 61
    assert len([line for line in world.log if "loses its name" in line]) == 1


@play
async def test_a_pod_that_says_the_same_again_changes_nothing(world: World) -> None:
    """Its probe describes it every few seconds, for as long as it lives."""
    pod = await up(world, TALKER)
    before = list(world.journal)
    await world.describe(pod)
    assert world.journal == before


@play
async def test_an_update_is_no_conflict(world: World) -> None:
    old, _ = await up(world, TALKER), await up(world, TALKER)
    await world.end_pod(old)
    await asyncio.sleep(2)
    assert (await describe(world))["conflicts"] == []


# -- ready or not --


@play
async def test_a_newcomer_is_quiet_a_second_after_its_last_registration(world: World) -> None:
    """The probe of its pod is told so, and who has the name."""
    old = await up(world, TALKER)
    new = start(world, {"/talker": [ROSOUT]})
    node = new.nodes[0]
    await registered(new)

    async def look() -> str:
        [[name, api, state, has]] = await world.describe(new)
        assert (name, api, has) == ("/talker", node.api, old.nodes[0].api)
        return str(state)

    assert await look() == "busy"
    await asyncio.sleep(0.9)
    assert await look() == "busy"
    await asyncio.sleep(0.1)
    assert await look() == "quiet"
    await node.register(*CHATTER)
    assert await look() == "busy"
    await asyncio.sleep(QUIET)
    await node.unregister(CHATTER)
    assert await look() == "busy"
