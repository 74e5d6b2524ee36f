"""What nodes hear from the gate, and what callers hear; in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

import pytest

from rigel_gate.calls import LARGE, Answer, Call
from rigel_gate.registry import PARAMETER, PUBLISHER, SERVICE, SUBSCRIBER
from tests.support.gate_stage import (
    ASK,
    CHATTER,
    HEARS,
    LISTENER,
    QUIET,
    RATE,
    ROSOUT,
    TALKER,
    describe,
    look_up,
    note_calls,
    play,
    publishers,
    registered,
    slow_down,
    start,
    up,
)
from tests.support.gate_world import Plan, SimPod, World

T = TypeVar("T")


def xml_call(value: str) -> Call:
    """A `setParam` with a value that xmlrpc.client would not write."""
    words = "".join(f"<param><value>{one}</value></param>" for one in ("/tool", "/x", value))
    name = "<methodName>setParam</methodName>"
    return Call.read(f"<methodCall>{name}<params>{words}</params></methodCall>".encode())


# -- what newcomers hear --


@play
async def test_a_newcomer_hears_no_publishers_before_it_has_its_name(world: World) -> None:
    """Two listeners of one name must not both hear a topic; at the hand-over it gets the list."""
    talker = await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    node = new.nodes[0]
    more = await up(world, {"/camera": [ROSOUT, CHATTER]})
    assert node.lists == [("/chatter", [])]
    await world.hand_over(old)
    await asyncio.sleep(0.1)
    assert sorted(node.heard["/chatter"]) == [talker.nodes[0].api, more.nodes[0].api]


LOAD = (SERVICE, "/manager/load_nodelet")
#: A manager of nodelets, and the program that loads one into it by a service.
NODELET: dict[str, Plan] = {"/echo": [ROSOUT], "/manager": [ROSOUT, LOAD]}


async def find_manager(world: World, pod: SimPod, node: str = "/echo", **more: Any) -> str | None:
    """Return where a node finds the manager's service."""
    call = Call("lookupService", (node, LOAD[1]))
    answer = await world.call(call, **{"hands_over": True, "host": pod.host, **more})
    return answer.result


@play
async def test_pods_of_which_one_replaces_the_other_find_their_own_services(world: World) -> None:
    """A loader finds the manager of its own pod, before and after the names change hands."""
    old = await up(world, NODELET)
    other = await up(world, LISTENER, "other")
    before = old.nodes[1].detail(*LOAD)
    assert await find_manager(world, old) == before
    new = start(world, {"/echo": [ROSOUT]})
    await registered(new)
    assert await find_manager(world, new) is None, "its own manager has not started yet"
    assert await find_manager(world, other, "/tool") == await find_manager(world, old) == before
    assert await find_manager(world, new, hands_over=False) == before
    world.start_node(new, "/manager", NODELET["/manager"])
    await registered(new)
    await asyncio.sleep(QUIET + 0.1)
    own = new.nodes[1].detail(*LOAD)
    assert await find_manager(world, new) == await find_manager(world, new, "/tool") == own
    assert await find_manager(world, old) == await find_manager(world, other, "/tool") == before
    await world.hand_over(old)
    assert await find_manager(world, old) is None
    assert await find_manager(world, new) == await find_manager(world, other, "/tool") == own


@play
async def test_services_are_not_mixed_up_while_names_change_hands(world: World) -> None:
    """The old loader asks all the time: it must not unload what the new one has loaded."""
    old, new = await up(world, NODELET), await up(world, NODELET)
    own = [pod.nodes[1].detail(*LOAD) for pod in (old, new)]
    handing_over = asyncio.ensure_future(world.hand_over(old))
    found = []
    while not handing_over.done() or len(found) < 10:
        asked = [asyncio.ensure_future(find_manager(world, pod)) for pod in (old, new)]
        found.append(await asyncio.gather(*asked))
        await asyncio.sleep(0.0001)
    assert {one for one, _ in found} <= {own[0], None}
    assert {one for _, one in found} == {own[1]}


@play
async def test_the_processes_of_a_waiting_pod_are_bound_to_each_other(world: World) -> None:
    """Or they would unload their nodelets after ten seconds; the old pod's they do not hear."""
    ends = [(PUBLISHER, "/manager/bond"), (SUBSCRIBER, "/manager/bond")]
    plans: dict[str, Plan] = {"/echo": [HEARS, *ends], "/manager": [CHATTER, *ends]}
    await up(world, plans)
    new = await up(world, plans)
    await asyncio.sleep(0.1)
    for node in new.nodes:
        assert sorted(node.heard["/manager/bond"]) == sorted(one.api for one in new.nodes)
    assert new.nodes[0].heard["/chatter"] == []
    await new.nodes[1].unregister(ends[0])
    await asyncio.sleep(0.1)
    assert new.nodes[0].heard["/manager/bond"] == [new.nodes[0].api]


@play
async def test_a_node_that_is_new_in_an_update_does_not_find_the_old_pods_services(
    world: World,
) -> None:
    """No name waits yet, but both pods have said that they belong to one workload."""
    old = await up(world, NODELET)
    new = await up(world, {"/second": [ROSOUT]})
    assert await find_manager(world, new, "/second") is None
    assert await find_manager(world, old) == old.nodes[1].detail(*LOAD)


@play
async def test_a_list_reaches_a_node_that_was_silent(world: World) -> None:
    """The newcomer's machine is away while it takes over: it hears its publishers all the same."""
    talker = await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    real = world.node

    async def node(api: str, call: Call, seconds: float) -> Answer:
        if call.method == "publisherUpdate":
            world.unreachable.add(new.host)
        return await real(api, call, seconds)

    world.node = node  # type: ignore[method-assign]
    assert await world.hand_over(old) == ["/listener"]
    await asyncio.sleep(10)
    assert new.nodes[0].heard["/chatter"] == []
    world.node = real  # type: ignore[method-assign]
    world.unreachable.discard(new.host)
    await asyncio.sleep(7)
    assert new.nodes[0].heard["/chatter"] == [talker.nodes[0].api]
    before = list(new.nodes[0].lists)
    await asyncio.sleep(10)
    assert new.nodes[0].lists == before, "once is enough"
    assert len([line for line in world.log if "of /chatter does not reach" in line]) == 1


@play
async def test_a_list_does_not_overtake_a_later_one(world: World) -> None:
    """The gate's list is slow; the publisher that registers meanwhile is not dropped by it."""
    await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    slow_down(world, "publisherUpdate", 0.3)
    handing = asyncio.ensure_future(world.hand_over(old))
    await asyncio.sleep(0.1)
    camera = await up(world, {"/camera": [CHATTER]})
    await handing
    lists = [heard for _, heard in new.nodes[0].lists]
    assert [camera.nodes[0].api in heard for heard in lists] == [False, False, True]


@play
async def test_a_list_does_not_overtake_another_hand_over(world: World) -> None:
    """The gate's list is slow; the publisher that takes over meanwhile is not dropped by it."""
    old_talker, new_talker = await up(world, TALKER), await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    slow_down(world, "publisherUpdate", 0.3)
    await world.hand_over(old)
    await world.hand_over(old_talker)
    await asyncio.sleep(1)
    lists = [heard for _, heard in new.nodes[0].lists]
    assert lists == [[], [old_talker.nodes[0].api], [new_talker.nodes[0].api]]


@play
async def test_a_list_does_not_bring_back_a_publisher(world: World) -> None:
    """The gate's list is slow; the publisher that unregisters meanwhile is not on the last one."""
    talker = await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    slow_down(world, "publisherUpdate", 0.3)
    await world.hand_over(old)
    await talker.nodes[0].unregister(CHATTER)
    await asyncio.sleep(1)
    assert [heard for _, heard in new.nodes[0].lists] == [[], [talker.nodes[0].api], []]


@play
async def test_a_list_that_is_on_its_way_is_followed_by_a_newer_one(world: World) -> None:
    """A publisher ends with the master while the list with it is on its way to a slow node."""
    talker = await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    slow_down(world, "publisherUpdate", 2)
    await world.hand_over(old)
    talker.nodes[0].end()
    world.kill_master()
    world.start_master()
    await asyncio.sleep(10)
    assert [heard for _, heard in new.nodes[0].lists] == [[], [talker.nodes[0].api], []]


@play
async def test_a_node_that_is_gone_is_not_called_again(world: World) -> None:
    """Its machine is back without it: no list goes there any more, look for look."""
    await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    real, called = world.node, []

    async def node(api: str, call: Call, seconds: float) -> Answer:
        if call.method == "publisherUpdate":
            called.append(api)
            world.unreachable.add(new.host)
        return await real(api, call, seconds)

    world.node = node  # type: ignore[method-assign]
    assert await world.hand_over(old) == ["/listener"]
    await asyncio.sleep(10)
    assert set(called) == {new.nodes[0].api}
    new.nodes[0].end()
    await up(world, LISTENER)
    await asyncio.sleep(5)
    called.clear()
    await asyncio.sleep(20)
    assert new.nodes[0].api not in called


@play
async def test_a_change_does_not_wait_for_a_frozen_node(world: World) -> None:
    """Half a second for its list to arrive; then the graph goes on, and the node gets it later."""
    await up(world, TALKER)
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    real, slow = world.node, 2.0

    async def node(api: str, call: Call, seconds: float) -> Answer:
        await asyncio.sleep(slow if call.method == "publisherUpdate" else 0)
        return await real(api, call, seconds)

    world.node = node  # type: ignore[method-assign]
    await world.hand_over(old)
    started = world.now()
    camera = world.start_pod("app", [], {})
    await world.start_node(camera, "/camera", []).register(*CHATTER)
    assert 0.4 < world.now() - started < 1
    await asyncio.sleep(10)
    assert camera.nodes[0].api in new.nodes[0].heard["/chatter"]
    world.broken.clear()  # its old list has come late, and after the new one


# -- services, parameters, and calls that change nothing --


@play
async def test_a_service_is_never_unknown_while_its_name_moves(world: World) -> None:
    """A look-up sees the master before a hand-over or after it."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    found: list[Any] = []

    async def look() -> None:
        while True:
            found.append((await look_up(world)).result)

    async def look_lazily() -> None:
        while True:
            await asyncio.sleep(0.0007)
            found.append((await look_up(world)).result)

    for _ in range(3):
        world.spawn(look())
        world.spawn(look_lazily())
    await asyncio.sleep(0.5)
    await world.hand_over(old)
    await asyncio.sleep(0.5)
    services = [pod.nodes[0].detail(*ASK) for pod in (old, new)]
    assert set(found) == set(services)


@play
async def test_a_look_up_that_waits_for_the_master_sees_no_half_of_a_hand_over(
    world: World,
) -> None:
    """The master comes back, and with the look-ups comes the hand-over that has waited as well."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    world.kill_master()
    looks = [asyncio.ensure_future(look_up(world)) for _ in range(20)]
    await asyncio.sleep(0.5)
    handing = asyncio.ensure_future(world.hand_over(old))
    await asyncio.sleep(0.5)
    world.start_master()
    found = [(await look).result for look in looks]
    assert await handing == ["/talker"]
    assert set(found) <= {pod.nodes[0].detail(*ASK) for pod in (old, new)}


@play
async def test_publishers_change_hands_first(world: World) -> None:
    """A subscriber that gets a list without a publisher ends its connection to it.

    Of the publishers, that of the log is the last.
    """
    plans: dict[str, Plan] = {"/all": [ROSOUT, RATE, HEARS, ASK, CHATTER]}
    old, _ = await up(world, plans), await up(world, plans)
    calls = note_calls(world)
    await world.hand_over(old)
    made = [call for call in calls if call.method.startswith(("register", "subscribe"))]
    assert [call.method for call in made] == [
        *("registerPublisher", "registerPublisher", "registerService"),
        *("registerSubscriber", "subscribeParam"),
    ]
    assert [call.params[1] for call in made[:2]] == ["/chatter", "/rosout"]


@play
async def test_changes_wait_while_a_name_moves(world: World) -> None:
    """No call of another node comes between those of a hand-over."""
    old, _ = await up(world, TALKER), await up(world, TALKER)
    calls = note_calls(world)
    handing = asyncio.ensure_future(world.hand_over(old))
    while not calls:
        await asyncio.sleep(0.001)
    await world.call(Call("setParam", ("/tool", "/x", 1)))
    await handing
    methods = [call.method for call in calls]
    assert methods.index("setParam") > methods.index("registerService")


@play
async def test_what_a_newcomer_takes_back_is_not_handed_over(world: World) -> None:
    """By rospy's multicall, too."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    answer = await new.nodes[0].unregister(CHATTER, ASK)
    assert [one[0][0] for one in answer.value] == [1, 1]
    assert publishers(world, "/chatter") == [old.nodes[0].api], "it is the old node's"
    await asyncio.sleep(QUIET + 0.1)
    await world.hand_over(old)
    assert publishers(world, "/rosout") == [new.nodes[0].api]
    assert publishers(world, "/chatter") == []
    assert not (await look_up(world)).is_success


@play
async def test_a_newcomer_that_has_taken_everything_back_waits_no_more(world: World) -> None:
    old, new = await up(world, TALKER), await up(world, TALKER)
    await new.nodes[0].unregister(ROSOUT, CHATTER, ASK)
    assert (await describe(world))["waiting"] == []
    assert await world.hand_over(old) == []


@play
async def test_a_newcomer_learns_parameters_and_their_changes(world: World) -> None:
    """Those that it has subscribed to, above them and below them."""
    await world.call(Call("setParam", ("/tool", "/camera/gain", 1)))
    plans: dict[str, Plan] = {"/camera": [(PARAMETER, "/camera/gain"), (PARAMETER, "/camera/size")]}
    await up(world, plans)
    node = (await up(world, plans)).nodes[0]
    assert node.learnt == {"/camera/gain": 1, "/camera/size": {}}
    for key, value in (("/camera/gain", 2), ("/camera/size/x", 3), ("/other", 4), ("/cam", 5)):
        await world.call(Call("setParam", ("/tool", key, value)))
    await asyncio.sleep(0.1)
    assert node.learnt == {"/camera/gain": 2, "/camera/size": {}, "/camera/size/x": 3}
    await world.call(Call("setParam", ("/tool", "/camera", {"gain": 6})))
    await asyncio.sleep(0.1)
    assert (node.learnt["/camera/gain"], node.learnt["/camera/size"]) == (6, {})
    await world.call(Call("deleteParam", ("/tool", "/camera/gain")))
    await asyncio.sleep(0.1)
    assert node.learnt["/camera/gain"] == {}


@play
async def test_a_parameters_name_is_the_callers(world: World) -> None:
    """`~gain` and `gain` are resolved as the master does it, also for what a new master gets."""
    await world.call(Call("setParam", ("/ns/camera", "~gain", 1)))
    await world.call(Call("setParam", ("/ns/camera", "rate", 2)))
    world.kill_master()
    world.start_master()
    for key, value in (("/ns/camera/gain", 1), ("/ns/rate", 2)):
        assert (await world.call(Call("getParam", ("/tool", key)))).result == value


@play
async def test_the_newest_value_reaches_a_node_last(world: World) -> None:
    """Two changes at once: what is slow on its way does not stay."""
    await world.call(Call("setParam", ("/tool", "/rate", 0)))
    await up(world, LISTENER)
    node = (await up(world, LISTENER)).nodes[0]
    await asyncio.gather(
        *(world.call(Call("setParam", ("/tool", "/rate", value))) for value in range(30))
    )
    await asyncio.sleep(1)
    assert world.master_now is not None
    assert node.learnt["/rate"] == world.master_now.parameters.get("/rate")


@play
async def test_a_late_value_of_the_gate_is_followed_by_the_newest(world: World) -> None:
    """The master has sent a later value to a node that has just taken over."""
    await world.call(Call("setParam", ("/tool", "/rate", 1)))
    old, new = await up(world, LISTENER), await up(world, LISTENER)
    slow_down(world, "paramUpdate", 1)
    await world.hand_over(old)
    await world.call(Call("setParam", ("/tool", "/rate", 2)))
    await asyncio.sleep(5)
    assert new.nodes[0].learnt["/rate"] == 2


@play
async def test_many_calls_in_one(world: World) -> None:
    """`system.multicall` answers each as the master does; a bad one is the master's to refuse."""
    inner = [
        {"methodName": "setParam", "params": ["/tool", "/x", 1]},
        {"methodName": "getParam", "params": ["/tool", "/x"]},
        {"methodName": "getParam", "params": ["/tool", "/y"]},
    ]
    answer = await world.call(Call("system.multicall", (inner,)))
    assert answer.value == [[[1, "", 0]], [[1, "", 1]], [[-1, "not set", 0]]]
    asked: list[Call] = []

    async def refuse(call: Call) -> Answer:
        asked.append(call)
        return Answer([-1, "what?", 0])

    world.master = refuse  # type: ignore[method-assign]
    for params in ((), (7,), ([{"methodName": "getParam"}],)):
        assert (await world.call(Call("system.multicall", params))).value == [-1, "what?", 0]
    assert len(asked) == 3


@pytest.mark.parametrize(
    "call",
    [
        Call("registerPublisher", ("/talker", "/chatter")),
        Call("registerPublisher", ("/talker", 7, "t/T", "http://h:1/")),
        Call("unregisterService", ("/talker",)),
        Call("setParam", ("/talker",)),
        Call("setParam", ("/talker", "/x")),
        Call("setParam", ("/talker", 7, 7)),
        Call("deleteParam", ()),
        Call("no such method", (1, 2)),
    ],
    ids=lambda call: call.method,
)
def test_what_the_gate_does_not_understand_is_the_masters_to_refuse(call: Call) -> None:
    @play
    async def story(world: World) -> None:
        world.master = refuse  # type: ignore[method-assign]
        assert (await world.call(call)).value == [-1, "what?", 0]
        assert world.gate is not None
        assert not world.gate.state.registry.nodes

    async def refuse(call: Call) -> Answer:
        return Answer([-1, "what?", 0])

    story()


@play
async def test_what_the_master_refuses_is_not_remembered(world: World) -> None:
    """A new master would be told what the old one did not take."""

    async def refuse(call: Call) -> Answer:
        return Answer([-1, "no", 0])

    node = (await up(world, {"/talker": [ROSOUT]})).nodes[0]
    await world.call(Call("setParam", ("/tool", "/x", 0)))
    assert world.gate is not None
    before = list(world.gate.state.events())
    world.master = refuse  # type: ignore[method-assign]
    await node.register(*CHATTER)
    await node.unregister(ROSOUT)
    await world.call(Call("setParam", ("/tool", "/x", 1)))
    assert list(world.gate.state.events()) == before
    await world.call(Call("deleteParam", ("/tool", "/x")))
    assert list(world.gate.state.events()) == before


@play
async def test_what_is_registered_again_is_not_written_down_again(world: World) -> None:
    """A node of rospy subscribes to a parameter with each line that it logs."""
    node = (await up(world, LISTENER)).nodes[0]
    before = list(world.journal)
    for entry in node.plan:
        assert (await node.register(*entry)).is_success
    assert world.journal == before


@play
async def test_what_the_master_refuses_in_a_hand_over_is_not_remembered(world: World) -> None:
    """The name changes hands with all the rest."""
    old, new = await up(world, TALKER), await up(world, TALKER)
    real = world.master

    async def master(call: Call) -> Answer:
        return Answer([-1, "no", 0]) if call.method == "registerService" else await real(call)

    world.master = master  # type: ignore[method-assign]
    assert await world.hand_over(old) == ["/talker"]
    assert publishers(world, "/chatter") == [new.nodes[0].api]
    assert world.gate is not None
    kinds = {kind for kind, _ in world.gate.state.registry.nodes["/talker"].registrations}
    assert kinds == {PUBLISHER}
    assert [line for line in world.log if "the master refuses service /talker/ask" in line]


@play
async def test_the_masters_address_is_the_gates(world: World) -> None:
    assert (await world.call(Call("getUri", ("/tool",)))).result == "http://ros-master:11311/"


# -- parameters that a later master could not be given --


def nested(value: Any, levels: int) -> Any:
    for _ in range(levels):
        value = [value]
    return value


@pytest.mark.parametrize(
    "call",
    [
        Call("setParam", ("/tool", "/a" * 500, 1)),
        Call("setParam", ("/tool", "/a" * 60, nested(1, 60))),
        Call("setParam", ("/tool", "/x", nested(1, 101))),
        xml_call("<array><data><value>" * 20_000 + "</value></data></array>" * 20_000),
        xml_call("<dateTime.iso8601>&lt;x&gt;</dateTime.iso8601>"),
        xml_call("<int>4294967296</int>"),
    ],
)
def test_a_parameter_that_could_not_be_kept_is_refused(call: Call):
    """With a fault, before roscore has it: gate and roscore would no longer agree."""

    async def story(world: World) -> None:
        await up(world, TALKER)
        calls = note_calls(world)
        answer = await world.call(call)
        assert answer.value[0] == -1
        assert "cannot be set" in answer.value[1]
        assert not [one for one in calls if one.method == "setParam"]
        assert world.gate is not None
        assert world.gate.state.parameters.own() == {}

    play(story)()


@play
async def test_a_parameter_of_many_levels_is_kept(world: World) -> None:
    """More than any robot has."""
    await up(world, TALKER)
    for key, value in (("/a" * 50, nested(1, 50)), ("/b", nested(1, 99))):
        assert (await world.call(Call("setParam", ("/tool", key, value)))).is_success
    world.kill_master()
    world.start_master()
    assert (await look_up(world)).is_success
    assert world.master_now is not None
    assert world.master_now.parameters.get("/b") == nested(1, 99)
    assert world.master_now.parameters.get("/a" * 50) == nested(1, 50)


@play
async def test_the_answers_of_many_calls_have_a_limit(world: World) -> None:
    """A small request for one large parameter, many times over, fills no memory."""
    await up(world, TALKER)
    await world.call(Call("setParam", ("/tool", "/map", 2**20 * "x")))
    one = {"methodName": "getParam", "params": ["/tool", "/map"]}
    calls = note_calls(world)
    few = await world.call(Call("system.multicall", ([one] * 3,)))
    assert [len(answer[0][2]) for answer in few.value] == [2**20] * 3
    many = await world.call(Call("system.multicall", ([one] * 400,)))
    assert many.value[0] == -1
    assert "more than" in many.value[1]
    assert len(calls) < 100


@play
async def test_all_parameters_together_have_a_limit(world: World) -> None:
    """Above it a gate could not start again in its memory; the master does not get it either."""
    await up(world, TALKER)
    large = 7 * 2**20 * "x"
    answers = [await world.call(Call("setParam", ("/n", f"/{n}", large))) for n in range(7)]
    assert [one.is_success for one in answers] == [True] * 6 + [False]
    assert "/6 cannot be set: all parameters have at most 50331648 bytes" in answers[-1].value[1]
    assert world.master_now is not None
    assert "6" not in world.master_now.parameters.tree
    assert (await world.call(Call("setParam", ("/n", "/5", large)))).is_success, "it replaces one"
    await world.call(Call("deleteParam", ("/n", "/5")))
    assert (await world.call(Call("setParam", ("/n", "/6", large)))).is_success


@play
async def test_what_takes_long_is_done_in_a_thread(world: World) -> None:
    """For a large call, also one of many calls; the loop only notes what has been made there."""
    made: list[Any] = []
    real = world.compute

    async def compute(work: Callable[[], T]) -> T:
        made.append(await real(work))
        return made[-1]  # type: ignore[no-any-return]

    world.compute = compute  # type: ignore[method-assign]
    await world.call(Call("setParam", ("/n", "/small", "x")))
    assert made == []
    one = Call.read(Call("setParam", ("/n", "/one", LARGE * "x")).body)
    two = {"methodName": "setParam", "params": ["/n", "/two", LARGE * "y"]}
    ask = {"methodName": "getParam", "params": ["/n", "/two"]}
    many = Call.read(Call("system.multicall", ([two, ask],)).body)
    for call in (one, many):
        await world.call(call)
    [first, value, _], [second, *_], read, body = made
    assert (first[1], value, second[1]) == ("/one", LARGE * "x", "/two")
    assert first.line.startswith(b'["set", "/one", "')
    assert read[2] == LARGE * "y"
    assert len(body) > LARGE
    assert world.gate is not None
    assert world.gate.state.parameters.tree["one"] is value, "it is not read again"
