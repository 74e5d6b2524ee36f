"""What a node publishes and hears in each mode, and what passes from one that worked before it."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from rigel_inpod.rmw_notes import FINISH, HOLD, STOP, WAIT, WORK
from tests.support.layer import Built, Node, build, name
from tests.support.until import until
from tests.unit.rmw.conftest import Start

pytestmark = pytest.mark.programs

UUID, OTHER = "11" * 16, "22" * 16
FIB = "/fib/_action"


@pytest.fixture
def waiting(start: Start) -> Node:
    """A node `/n` that waits."""
    return name(start("wait"))


def test_a_node_that_works_publishes_and_hears_everything(node: Node) -> None:
    """The layer changes nothing, and notes what passes."""
    node.do("create p /out 0")
    node.do("create s /in 0")
    for number in (1, 2):
        assert node.do(f"publish /out {number}") == "0"
        node.do(f"arrive /in 1 {number}")
        assert node.do("take /in") == str(number)
    assert node.do("take /in") == "-"
    assert node.do("sent p /out") == "1 2"
    assert node.entity("/out")["count"] == node.entity("/in")["count"] == 2
    assert node.entity("/in")["node"] == "/n"
    assert node.entity("/in")["type"] == "std_msgs/msg/UInt64"


@pytest.mark.parametrize("how", ["plain", "serialized", "loaned"])
def test_a_node_that_waits_publishes_nothing(waiting: Node, how: str) -> None:
    """Its publications succeed, reach no one, and are not sent later."""
    waiting.do("create p /out 0")
    assert waiting.do(f"publish /out 1 {how}") == "0"
    waiting.notes.set_mode(WORK)
    assert waiting.do(f"publish /out 2 {how}") == "0"
    assert waiting.do("sent p /out") == "2"
    assert waiting.entity("/out")["dropped"] == 1


@pytest.mark.parametrize("topic", ["/rosout", "/parameter_events"])
def test_what_a_node_logs_passes_while_it_waits(waiting: Node, topic: str) -> None:
    """The user sees why it does not become ready."""
    waiting.do(f"create p {topic} 0")
    waiting.do(f"publish {topic} 1")
    assert waiting.do(f"sent p {topic}") == "1"


@pytest.mark.parametrize("how", ["plain", "serialized", "loaned"])
def test_latched_messages_are_given_out_when_it_works(waiting: Node, how: str) -> None:
    """As many as the publisher keeps, in their order, without another call of the node."""
    waiting.do("create p /map 1 2")
    for number in (1, 2, 3):
        waiting.do(f"publish /map {number} {how}")
    assert waiting.do("sent p /map") == ""
    waiting.notes.set_mode(WORK)
    until(lambda: waiting.do("sent p /map") == "2 3", "latched messages are sent")


def test_a_latched_message_of_a_node_that_stopped_goes_out_if_it_works_again(
    waiting: Node,
) -> None:
    """The other one may end; what this one says of its state must not be lost."""
    waiting.do("create p /map 1")
    waiting.notes.set_mode(STOP)
    waiting.do("publish /map 1")
    waiting.notes.set_mode(WAIT)
    assert waiting.do("sent p /map") == ""
    waiting.notes.set_mode(WORK)
    until(lambda: waiting.do("sent p /map") == "1", "the latched message is sent")


def test_latched_messages_of_a_publisher_that_went_are_forgotten(waiting: Node) -> None:
    """Nothing is sent by a publisher that does not exist any more."""
    waiting.do("create p /map 1")
    waiting.do("create p /other 1")
    waiting.do("publish /map 1")
    waiting.do("publish /other 2")
    waiting.do("destroy p /map")
    waiting.notes.set_mode(WORK)
    until(lambda: waiting.do("sent p /other") == "2", "the other one is sent")


@pytest.mark.parametrize("how", ["plain", "info", "loaned", "sequence"])
def test_a_node_that_waits_hears_nothing(waiting: Node, how: str) -> None:
    """What arrives is taken from the queue, and not handed to the node."""
    waiting.do("create s /in 0")
    waiting.do("arrive /in 1 1")
    assert waiting.do(f"take /in {how}") == "-"
    waiting.notes.set_mode(WORK)
    assert waiting.do("take /in") == "-"
    waiting.do("arrive /in 1 2")
    assert waiting.do("take /in") == "2"


@pytest.mark.parametrize(
    ("topic", "durability"), [("/map", 1), ("/tf", 0), ("/tf_static", 0), ("/clock", 0), ("/w", 0)]
)
def test_what_builds_up_state_is_heard_while_it_waits(
    start: Start, topic: str, durability: int
) -> None:
    """Latched topics, transforms, the clock and what `warm` names; in the next mode as well."""
    node = name(start("wait", RIGEL_RMW_WARM="/x:/w"))
    node.do(f"create s {topic} {durability}")
    for number, mode in enumerate((WAIT, HOLD), start=1):
        node.notes.set_mode(mode)
        node.do(f"arrive {topic} 1 {number}")
        assert node.do(f"take {topic}") == str(number)
    key = node.entity(topic)["key"]
    node.do(f"arrive {topic} 1 3")
    node.notes.write_drop({str(key): {"01" + "00" * 14 + "01": 3}}, [])
    node.notes.set_mode(WORK)
    assert node.do(f"take {topic}") == "3"


def test_requests_to_a_node_that_waits_are_those_of_its_container(
    start: Start, either: Built
) -> None:
    """A lifecycle manager and its nodes come up together, and no other client is answered."""
    node = name(start("wait", of=either))
    node.do("create v /work 0")
    node.do("create p /out 0")
    node.do("create c /of/others 0")
    node.do("ask /work 5 1")
    assert node.do("serve /work") == "-"
    node.do("ask /work own 2")
    assert node.do("serve /work") == "2"
    friend = name(start("wait", of=either))
    friend.do("create p /out 0")
    friend.do("create c /work 0")
    node.do(f"ask /work {friend.do('pid')} 3")
    assert node.do("serve /work") == "3"


def test_requests_of_another_pods_processes_are_left_to_that_pod(
    start: Start, either: Built
) -> None:
    """A lifecycle manager in the pod that waits configures its own nodes, not the old pod's."""
    old = name(start("work", of=either, directory="old"))
    new = name(start("wait", of=either, directory="new"))
    for one in (old, new):
        one.do("create v /work 0")
        one.do("create p /out 0")
        one.do("create c /work 0")
    old.notes.set_others(new.notes.friends())
    old.do(f"ask /work {new.do('pid')} 1")
    assert old.do("serve /work") == "-"
    old.do("ask /work 5 2")
    assert old.do("serve /work") == "2"
    old.notes.set_others([])
    old.do(f"ask /work {new.do('pid')} 3")
    assert old.do("serve /work") == "3"


@pytest.mark.parametrize("fake", [(), ("-DHUMBLE",)], ids=["jazzy", "humble"])
def test_a_service_of_another_pod_alone_is_not_available(
    start: Start, tmp_path: Path, fake: tuple[str, ...]
) -> None:
    """A lifecycle manager in the pod that waits waits for its own nodes, not for the old pod's."""
    made = build(tmp_path, *fake)
    old, new = (start("wait", directory=name, of=made) for name in ("old", "new"))
    for one in (old, new):
        name(one)
        one.do("create p /out 0")
    new.do("create c /work 0")
    new.do(f"served /work {old.do('pid')}")
    assert new.do("available /work") == "no"  # it is not known yet who the others are
    new.notes.set_others(old.notes.friends())
    assert new.do("available /work") == "no"
    new.do(f"served /work {new.do('pid')}")
    assert new.do("available /work") == "no"  # the others do not know yet whose requests are new's
    new.notes.set_known(new.notes.friends())
    assert new.do("available /work") == "yes"
    new.do("create c /of/others 0")
    assert new.do("available /of/others") == "yes"  # as the middleware says
    new.notes.set_mode(WORK)
    assert new.do("available /work") == "yes"


def test_what_arrives_while_it_holds_stays_for_later(waiting: Node) -> None:
    """Neither taken nor announced by a wait set."""
    waiting.do("create s /in 0")
    waiting.do("create v /work 0")
    waiting.notes.set_mode(HOLD)
    waiting.do("arrive /in 1 1")
    waiting.do("ask /work 1 1")
    assert waiting.do("wait 30") == "timeout"
    assert waiting.do("take /in") == waiting.do("serve /work") == "-"
    waiting.notes.set_mode(WORK)
    assert waiting.do("wait 5000") == "ready /in /work"
    assert waiting.do("take /in") == waiting.do("serve /work") == "1"


def test_a_wait_goes_on_when_the_mode_changes(waiting: Node) -> None:
    """What was held is announced to a thread that already waits."""
    waiting.do("create s /in 0")
    waiting.notes.set_mode(HOLD)
    waiting.do("arrive /in 1 1")
    waiting.send("wait 20000")
    until(waiting.notes.is_idle, "it waits")
    waiting.notes.set_mode(WORK)
    assert waiting.process.stdout
    assert waiting.process.stdout.readline() == "ready /in\n"


def test_a_thread_that_waits_for_its_turn_is_idle(node: Node) -> None:
    """As soon as another one waits, even if timers never rest; not when it has taken something."""
    node.do("create s /in 0")
    node.do("turn")
    assert not node.notes.is_idle()
    node.do("beside")
    until(node.notes.is_idle, "one that waits", every=0.01)
    for _ in range(5):
        node.do("turn")
        assert node.notes.is_idle()
    numbers = itertools.count(1)

    def takes() -> bool:
        node.do(f"arrive /in 1 {next(numbers)}")
        node.do("take /in")
        return not node.notes.is_idle()

    until(takes, "one that is busy")
    until(node.notes.is_idle, "a rest")


def test_nothing_is_handled_twice_and_nothing_is_lost(start: Start, either: Built) -> None:
    """The new one drops what the old one has taken, of each writer, and takes the rest."""
    old = name(start(of=either, directory="old"))
    new = name(start("wait", of=either, directory="new"))
    for one in (old, new):
        one.do("create s /in 0")
        one.do("create s /in 0")
        one.do("create v /work 0")
    new.notes.set_mode(HOLD)
    for one in (old, new):
        for number in (1, 2, 3):
            one.do(f"arrive /in 1 {number}")
            one.do(f"arrive /in 2 {10 * number}")
            one.do(f"ask /work 3 {number}")
    assert [old.do("take /in") for _ in range(3)] == ["1", "10", "2"]
    assert old.do("serve /work") == "1"
    old.notes.set_mode(FINISH)
    assert old.do("take /in") == old.do("serve /work") == "-"
    new.notes.write_drop(old.notes.newest(), [])
    new.notes.set_mode(WORK)
    assert [new.do("take /in") for _ in range(6)] == ["-", "-", "-", "20", "3", "30"]
    assert [new.do("serve /work") for _ in range(3)] == ["-", "2", "3"]


@pytest.mark.parametrize(("how", "fake"), [("sequence", ()), ("humble", ("-DHUMBLE",))])
def test_of_several_messages_only_those_that_were_taken_are_dropped(
    start: Start, tmp_path: Path, how: str, fake: tuple[str, ...]
) -> None:
    """Each message keeps its own information."""
    built = build(tmp_path, *fake)
    old, new = name(start(of=built, directory="o")), name(start("wait", of=built, directory="n"))
    for one in (old, new):
        one.do("create s /in 0")
    new.notes.set_mode(HOLD)
    for writer, number in ((1, 1), (2, 20), (1, 2), (2, 30), (1, 3)):
        new.do(f"arrive /in {writer} {number}")
        if number < 3:
            old.do(f"arrive /in {writer} {number}")
    assert old.do(f"take /in {how}") == "1 2"
    assert old.do(f"take /in {how}") == "-"
    old.notes.set_mode(FINISH)
    new.notes.write_drop(old.notes.newest(), [])
    new.notes.set_mode(WORK)
    assert new.do(f"take /in {how}") == "20 30 3"
    assert [new.entity("/in")[of] for of in ("count", "dropped")] == [3, 2]
    assert sorted(n for w in new.notes.newest().values() for n in w.values()) == [3, 30]


def test_two_subscriptions_of_one_topic_are_told_apart(start: Start) -> None:
    """What one of them has taken is not dropped for the other."""
    node = name(start())
    node.do("create s /in 0")
    node.do("create s /in 0")
    keys = [one.key for p in node.notes.processes() for one in p.entities if one.name == "/in"]
    assert len(set(keys)) == 2


def test_keys_are_the_same_in_every_process_of_a_workload(start: Start) -> None:
    """They name kind, node and name."""
    nodes = [name(start(directory=room)) for room in ("a", "b")]
    nodes[0].do("create p /before 0")
    for one in nodes:
        one.do("create s /in 0")
        one.do("create p /in 0")
    other = start(directory="c")
    other.do("node n /space")
    other.do("create s /in 0")
    seen = [one.notes.survey() for one in (*nodes, other)]
    keys = [{*its_nodes, *partners} for its_nodes, partners in seen]
    assert len(keys[0]) == 4
    assert keys[1] < keys[0]
    assert not keys[2] & keys[0]


def test_a_middleware_without_numbers_is_told_by_its_timestamps(node: Node) -> None:
    """The newest message of a publisher is then the one of the latest time."""
    node.do("create s /in 0")
    node.do("arrive /in 1 77 uncounted")
    assert node.do("take /in") == "77"
    assert [list(writers.values()) for writers in node.notes.newest().values()] == [[77]]


def test_a_node_that_is_not_complete_is_not_fit(waiting: Node) -> None:
    """Its constructor publishes events of its parameters before all of its topics are there."""
    for topic in ("/parameter_events", "/rosout", "/out"):
        waiting.do(f"create p {topic} 0")
    waiting.do("publish /parameter_events 1")
    waiting.do("publish /rosout 1")
    assert not waiting.notes.fit()
    waiting.do("publish /out 1")
    assert waiting.notes.fit()


def test_a_node_is_known_to_whoever_reaches_it(waiting: Node) -> None:
    """Whether it works or not; of what builds up its state no single publisher is noted."""
    waiting.do("create s /in 0")
    waiting.do("create s /map 1")
    waiting.do("create s /quiet 0")
    assert waiting.notes.hears(60) == {}
    waiting.do("arrive /in 1 77")
    waiting.do("arrive /map 2 1")
    assert [waiting.do(f"take {topic}") for topic in ("/in", "/map")] == ["-", "1"]
    keys = {one.name: one.key for p in waiting.notes.processes() for one in p.entities}
    heard = waiting.notes.hears(60)
    assert set(heard) == {keys["/in"], keys["/map"]}
    assert (len(heard[keys["/in"]][0]), heard[keys["/map"]]) == (32, [""])
    assert waiting.notes.hears(0) == {}
    assert waiting.notes.name({keys["/in"], "0000"}) == ["/in"]


def test_what_a_waiting_node_drops_is_noted(waiting: Node) -> None:
    """So that the old one is left to take it before it stops."""
    waiting.do("create s /in 0")
    waiting.do("create v /work 0")
    waiting.do("arrive /in 1 5")
    waiting.do("ask /work 1 6")
    waiting.do("take /in")
    waiting.do("serve /work")
    numbers = [number for one in waiting.notes.dropped().values() for number in one.values()]
    assert sorted(numbers) == [5, 6]
    assert not waiting.notes.newest()


def test_a_publisher_whose_handle_says_nothing_is_not_noted(start: Start, tmp_path: Path) -> None:
    """Of Cyclone DDS, after it has left: what it sent passes, and no other process waits for it."""
    node = name(start(of=build(tmp_path, "-DCYCLONE")))
    node.do("create s /in 0")
    node.do("arrive /in 99 1")
    assert node.do("take /in") == "1"
    assert not node.notes.newest()
    node.notes.set_mode(WAIT)
    node.do("arrive /in 99 2")
    assert node.do("take /in") == "-"
    assert not node.notes.dropped()


def test_a_client_that_has_left_is_not_answered_twice(start: Start, either: Built) -> None:
    """Its handle of Cyclone DDS says nothing any more when the new node takes its request."""
    old = name(start(of=either, directory="old"))
    new = name(start("wait", of=either, directory="new"))
    for one in (old, new):
        one.do("create v /work 0")
        one.do("ask /work 99 1")
    assert old.do("serve /work") == "1"
    new.notes.write_drop(old.notes.newest(), [])
    new.notes.set_mode(WORK)
    assert new.do("serve /work") == "-"


def test_many_writers_are_noted_and_the_silent_ones_forgotten(node: Node) -> None:
    """A thousand clients that come and go leave room for those that stay."""
    node.do("create v /work 0")
    for client in range(1, 1600):
        node.do(f"ask /work {client} 1")
        node.do("serve /work")
    (writers,) = node.notes.newest().values()
    assert 500 < len(writers) <= 1024
    assert (1599).to_bytes(4, "little").hex() in {writer[:8] for writer in writers}


def test_a_node_that_finishes_publishes_and_takes_nothing(node: Node) -> None:
    """The output of what it has taken before still goes out; then nothing does."""
    node.do("create p /out 0")
    node.do("create s /in 0")
    node.do("create v /work 0")
    node.do("ask /work 1 1")
    assert node.do("serve /work") == "1"
    node.notes.set_mode(FINISH)
    node.do("arrive /in 1 1")
    assert node.do("take /in") == "-"
    node.do("publish /out 1")
    node.notes.set_mode(STOP)
    node.do("wait 1")
    node.do("publish /out 2")
    assert node.do("sent p /out") == "1"
    assert node.do("answer /work 1 1") == "0"
    assert node.do("sent v /work") == "1"


@pytest.mark.parametrize("begin", ["take /in", "serve /work", "timer", "response /other 1"])
def test_what_has_begun_is_finished_after_the_switch(node: Node, begin: str) -> None:
    """A callback in a thread of a pool publishes late: its message is handled by no one else."""
    node.do("create p /out 0")
    node.do("create s /in 0")
    node.do("create v /work 0")
    node.do("create c /other 0")
    node.do("request /other 1")
    node.do("arrive /in 1 1")
    node.do("ask /work 1 1")
    if not begin.startswith("response"):
        assert node.do(begin) in ("0", "1")
    node.notes.set_mode(STOP)
    if begin.startswith("response"):
        assert node.do(begin) == "1"
    node.do("publish /out 1")
    node.do("timer" if begin.startswith("take") else "wait 1")
    node.do("publish /out 2")
    assert node.do("sent p /out") == "1"


def test_what_begins_after_the_switch_publishes_nothing(node: Node) -> None:
    """Neither a timer nor the response to a later request."""
    node.do("create p /out 0")
    node.do("create c /other 0")
    node.notes.set_mode(STOP)
    node.do("timer")
    node.do("publish /out 1")
    node.do("request /other 1")
    assert node.do("response /other 1") == "1"
    node.do("publish /out 2")
    assert node.do("sent p /out") == ""


def action(node: Node) -> Node:
    """Give a node an action server."""
    for part in ("send_goal", "get_result", "cancel_goal"):
        node.do(f"create v {FIB}/{part} 0")
    node.do(f"create p {FIB}/status 1")
    return node


@pytest.mark.parametrize("language", ["c", "cpp"])
def test_goals_are_open_from_their_request_to_their_end(node: Node, language: str) -> None:
    """As the server's status says it, in C and in C++; refused ones never are."""
    action(node)
    node.do(f"ask {FIB}/send_goal 1 1 {UUID}")
    node.do(f"ask {FIB}/send_goal 1 2 {OTHER}")
    assert [node.do(f"serve {FIB}/send_goal") for _ in range(2)] == ["1", "2"]
    assert node.notes.goals() == {UUID: True, OTHER: True}
    node.do(f"answer {FIB}/send_goal 1 1 1")
    node.do(f"answer {FIB}/send_goal 1 2 0")
    assert node.notes.goals() == {UUID: True}
    node.do(f"status {FIB}/status {UUID} 2 {language}")
    assert node.notes.goals() == {UUID: True}
    assert [process.goals for process in node.notes.processes()] == [("/fib",)]
    node.do(f"status {FIB}/status {UUID} 5 {language}")
    assert node.notes.goals() == {UUID: False}
    assert [process.goals for process in node.notes.processes()] == [()]


def test_a_result_that_is_asked_for_is_unanswered_until_it_is_sent(node: Node) -> None:
    """The old one stays for its clients."""
    action(node)
    node.do(f"ask {FIB}/get_result 1 1 {UUID}")
    node.do(f"serve {FIB}/get_result")
    assert node.notes.unanswered() == 1
    node.do(f"answer {FIB}/get_result 1 1")
    assert node.notes.unanswered() == 0


@pytest.mark.parametrize("mode", [WORK, WAIT])
def test_goals_are_held_in_both_while_one_drains(node: Node, mode: int) -> None:
    """New goals wait for the new one; all other services go on."""
    action(node)
    node.notes.set_mode(mode)
    node.notes.set_hold_goals(True)
    node.do(f"ask {FIB}/send_goal 1 1 {UUID}")
    assert node.do("wait 30") == "timeout"
    assert node.do(f"serve {FIB}/send_goal") == "-"
    node.do(f"ask {FIB}/cancel_goal 1 1 {UUID}")
    assert node.do(f"serve {FIB}/cancel_goal") == ("1" if mode == WORK else "-")
    node.notes.set_mode(WORK)
    node.notes.set_hold_goals(False)
    assert node.do("wait 5000") == f"ready {FIB}/send_goal"
    assert node.do(f"serve {FIB}/send_goal") == "1"


@pytest.mark.parametrize("part", ["get_result", "cancel_goal"])
def test_results_and_cancelling_go_to_the_one_that_has_the_goal(start: Start, part: str) -> None:
    """The old one still answers for its goals after it has stopped, the new one for all others."""
    old, new = action(name(start(directory="o"))), action(name(start("wait", directory="n")))
    old.do(f"ask {FIB}/send_goal 1 1 {UUID}")
    old.do(f"serve {FIB}/send_goal")
    old.do(f"answer {FIB}/send_goal 1 1 1")
    old.notes.set_mode(STOP)
    new.notes.write_drop(old.notes.newest(), old.notes.goals())
    new.notes.set_mode(WORK)
    for one in (old, new):
        one.do(f"ask {FIB}/{part} 1 1 {UUID}")
        one.do(f"ask {FIB}/{part} 1 2 {OTHER}")
    assert old.do("wait 30") == f"ready {FIB}/{part}"
    assert [old.do(f"serve {FIB}/{part}") for _ in range(2)] == ["1", "-"]
    assert [new.do(f"serve {FIB}/{part}") for _ in range(2)] == ["-", "2"]


def test_more_goals_than_have_room_leave_the_open_ones(node: Node) -> None:
    """Goals that have ended make room."""
    action(node)
    for number in range(1, 400):
        uuid = number.to_bytes(16, "big").hex()
        node.do(f"ask {FIB}/send_goal 1 {number} {uuid}")
        node.do(f"serve {FIB}/send_goal")
        node.do(f"answer {FIB}/send_goal 1 {number} 1")
        if number > 3:
            node.do(f"status {FIB}/status {uuid} 4 c")
    still = [uuid for uuid, is_open in node.notes.goals().items() if is_open]
    assert sorted(still) == [number.to_bytes(16, "big").hex() for number in (1, 2, 3)]


def test_goals_end_with_their_server(node: Node) -> None:
    """A server that is destroyed keeps no one waiting."""
    action(node)
    node.do(f"ask {FIB}/send_goal 1 1 {UUID}")
    node.do(f"serve {FIB}/send_goal")
    node.do(f"destroy v {FIB}/send_goal")
    assert node.notes.goals() == {UUID: False}


@pytest.mark.parametrize(("kind", "what", "ask"), [("s", "/in", "arrive"), ("v", "/work", "ask")])
def test_executors_of_events_are_told_of_what_was_held(
    waiting: Node, kind: str, what: str, ask: str
) -> None:
    """When it works, and not before; what was announced before is announced again if need be."""
    waiting.do(f"create {kind} {what} 0")
    assert waiting.do(f"listen {kind} {what}") == "0"
    take = ("take" if kind == "s" else "serve") + f" {what}"
    waiting.do(f"{ask} {what} 1 1")
    assert waiting.do(f"told {kind} {what}") == "1"
    waiting.notes.set_mode(HOLD)
    waiting.do(f"{ask} {what} 1 2")
    assert waiting.do(take) == "-"
    assert waiting.do(f"told {kind} {what}") == "1"
    waiting.notes.set_mode(WORK)
    until(lambda: waiting.do(f"told {kind} {what}") == "3", "what was held is announced")
    assert [waiting.do(take), waiting.do(take)] == ["1", "2"]
    executors = [one for p in waiting.notes.processes() for one in p.entities if one.thread == 0]
    assert [one.count for one in executors if one.kind == "executor"] == [3]
