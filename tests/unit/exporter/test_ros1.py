"""ROS 1's half against a master and nodes of threads: what is there, what is heard, and its end."""

from __future__ import annotations

import struct
import threading
import xmlrpc.client
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from rigel_exporter import ros1_topic, ros1_view
from rigel_exporter.graph import Graph, Node, Topic
from rigel_exporter.ros1 import Ros1
from tests.support.rosgraph import RosGraph, ros_graph, until

TEXT = struct.pack("<I", 5) + b"hello"
STAMPED = {"message_definition": "std_msgs/Header header"}


@pytest.fixture
def graph() -> Iterator[RosGraph]:
    with ros_graph() as found:
        yield found


@pytest.fixture
def ros1(graph: RosGraph, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ros1]:
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    monkeypatch.setattr(ros1_topic, "_RETRY", 0.01)
    half = Ros1(graph.master.uri)
    yield half
    half.close()


def nodes(found: Graph) -> dict[str, Node]:
    return {node.name: node for node in found.nodes}


# -- the end --


def test_after_close_nothing_runs_on(graph: RosGraph) -> None:
    """Neither threads that ask nodes nor the slave API."""
    graph.node("/talker", ["/chatter"])
    half = Ros1(graph.master.uri)
    half.subscribe("/other")
    half.look()
    half.close()
    names = {thread.name for thread in threading.enumerate()}
    assert not [name for name in names if name.startswith(("ros1", "slave"))]


def test_it_ends_though_the_master_is_gone(graph: RosGraph, ros1: Ros1) -> None:
    """Nobody to take leave of is no reason to stay."""
    ros1.subscribe("/chatter")
    ros1.look()
    graph.master.close()
    ros1.close()


# -- the graph --


def test_registered_nodes_that_answer_are_up(graph: RosGraph, ros1: Ros1) -> None:
    graph.node("/talker", ["/chatter"])
    graph.node("/listener", subscribes=["/chatter"])
    graph.master.types["/chatter"] = "std_msgs/String"
    found = ros1.look()
    assert {name: (n.up, n.registered, n.missing) for name, n in nodes(found).items()} == {
        "/talker": (True, True, 0),
        "/listener": (True, True, 0),
    }
    assert list(found.topics) == [Topic("/chatter", "std_msgs/String", 1, 1)]
    assert found.master is not None
    assert (found.master.up, found.master.pid, found.master.run) == (True, 1, "run-1")


def test_a_process_is_another_one_by_its_port_or_its_number(graph: RosGraph, ros1: Ros1) -> None:
    """In a container both may be the same again, but not together."""
    node = graph.node("/talker", ["/chatter"], pid=1)
    host, first = nodes(ros1.look())["/talker"].process
    node.pid = 2
    assert nodes(ros1.look())["/talker"].process == (host, f"{first.split()[0]} 2")
    assert (host, first.split()[1]) == ("127.0.0.1", "1")


def test_a_node_that_does_not_answer_is_not_up(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is registered still: that it hangs is what somebody wants to be told of."""
    silent, connect_node = graph.serve_silence(), ros1_view.connect_node

    def connect(uri: str, caller: str, seconds: float) -> Any:
        assert seconds == ros1_view.ANSWER
        return connect_node(uri, caller, 0.2 if uri == silent else 60)

    monkeypatch.setattr(ros1_view, "connect_node", connect)
    graph.master.add("/hangs", silent, ["/chatter"])
    graph.node("/talker", ["/chatter"])
    found = nodes(ros1.look())
    assert (found["/hangs"].up, found["/hangs"].registered) == (False, True)
    assert found["/talker"].up


def test_an_orphan_is_told_as_one(graph: RosGraph, ros1: Ros1) -> None:
    """A node that lives on while a new master does not know it is not up, and not registered."""
    graph.node("/talker", ["/chatter"])
    ros1.look()
    graph.master.drop("/talker")
    del graph.master.nodes["/talker"]
    orphan = nodes(ros1.look())["/talker"]
    assert (orphan.up, orphan.registered) == (False, False)
    assert orphan.missing == 1


def test_an_orphan_that_is_busy_for_a_while_is_still_one(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No master has its address: an orphan that is forgotten is never found again."""
    node = graph.node("/talker", ["/chatter"])
    ros1.look()
    graph.master.drop("/talker")
    del graph.master.nodes["/talker"]
    calm = threading.Event()
    monkeypatch.setattr(ros1_view, "ANSWER", 60.0)
    with monkeypatch.context() as busy:
        busy.setattr(node, "getPid", lambda caller: calm.wait(60), raising=False)
        busy.setattr(ros1_view, "ANSWER", 0.2)
        assert nodes(ros1.look()) == {}
    calm.set()
    assert nodes(ros1.look())["/talker"].missing == 1


def test_an_orphan_that_stays_silent_is_forgotten(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its address may become another node's."""
    node = graph.node("/talker", ["/chatter"])
    node.stats = [[["/chatter", "90", [["1", 110, 9, True]]]], [], []]
    ros1.look()
    graph.master.drop("/talker")
    node.close()
    assert list(ros1.look().traffic)
    monkeypatch.setattr("rigel_exporter.ros1._FRESH", -1.0)
    assert not list(ros1.look().traffic)


def test_a_node_that_ended_in_order_is_forgotten(graph: RosGraph, ros1: Ros1) -> None:
    node = graph.node("/talker", ["/chatter"])
    ros1.look()
    graph.master.drop("/talker")
    node.close()
    assert nodes(ros1.look()) == {}


def test_what_the_master_does_not_know_of_a_node_is_counted(graph: RosGraph, ros1: Ros1) -> None:
    node = graph.node("/talker", ["/chatter"])
    node.publishes.append("/lost")
    node.subscribes.append("/lost_too")
    assert nodes(ros1.look())["/talker"].missing == 2


def test_what_a_node_registers_during_a_look_is_not_missing(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The master is asked again before a topic counts as missing."""
    graph.node("/talker", ["/chatter", "/late"])
    late, real = graph.master.publishers.pop("/late"), graph.master.getSystemState

    def answer(caller: str) -> list[object]:
        found = real(caller)
        graph.master.publishers["/late"] = late
        return found

    monkeypatch.setattr(graph.master, "getSystemState", answer, raising=False)
    assert nodes(ros1.look())["/talker"].missing == 0


def test_a_node_without_an_address_costs_no_other_its_own(graph: RosGraph, ros1: Ros1) -> None:
    graph.master.publishers["/a"] = ["/a_ghost"]
    graph.node("/talker", ["/chatter"])
    found = nodes(ros1.look())
    assert (found["/a_ghost"].up, found["/talker"].up) == (False, True)


def test_without_a_master_its_nodes_are_asked_still(graph: RosGraph, ros1: Ros1) -> None:
    graph.node("/talker", ["/chatter"])
    ros1.look()
    graph.master.close()
    found = ros1.look()
    assert found.master is not None
    assert not found.master.up
    assert [(n.name, n.up, n.registered) for n in found.nodes] == [("/talker", False, False)]


def test_what_nodes_count_is_added_up(graph: RosGraph, ros1: Ros1) -> None:
    node = graph.node("/talker", ["/chatter"])
    node.stats = [[["/chatter", "90", [["1", 110, 9, True]]]], [], []]
    ros1.look()
    node.stats = [[["/chatter", "90", [["1", 150, 12, True]]]], [], []]
    [traffic] = ros1.look().traffic
    assert (traffic.direction, traffic.messages, traffic.size) == ("published", 12, 150)


def test_exporters_are_not_in_the_graph(graph: RosGraph, ros1: Ros1) -> None:
    """Neither this one nor another release's is anybody's node or subscriber."""
    graph.node("/talker", ["/chatter"])
    graph.node("/ros_exporter_other", subscribes=["/chatter"])
    ros1.subscribe("/chatter")
    ros1.look()
    found = ros1.look()
    assert set(nodes(found)) == {"/talker"}
    assert [(t.publishers, t.subscribers) for t in found.topics] == [(1, 0)]


def test_the_expected_nodes_are_asked_first(
    graph: RosGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With more nodes than are asked, the rest is counted as dropped."""
    for name in ("/a", "/b", "/z"):
        graph.node(name, ["/chatter"])
    half = Ros1(graph.master.uri, first=["/z"], most=2)
    try:
        found = half.look()
    finally:
        half.close()
    assert set(nodes(found)) == {"/z", "/a"}
    assert found.dropped == {"nodes": 1}


# -- named topics --


def test_each_message_is_counted_once(graph: RosGraph, ros1: Ros1) -> None:
    """With its bytes, however many publishers there are; kept payloads are handed out once."""
    one, two = graph.node("/one", ["/chatter"]), graph.node("/two", ["/chatter"])
    hearing = ros1.subscribe("/chatter", keep=2)
    ros1.look()
    for node in (one, two):
        node.wait_for_subscriber("/chatter")
    for _ in range(3):
        one.publish("/chatter", TEXT)
    two.publish("/chatter", TEXT)
    until(lambda: hearing.samples().messages >= 4, "all messages are heard")
    found = hearing.samples()
    assert (found.messages, found.size) == (4, 4 * len(TEXT))
    one.publish("/chatter", TEXT)
    until(lambda: hearing.samples().messages > 4, "another one")
    assert hearing.samples().messages == 5


def test_kept_payloads_are_the_latest_and_come_once(graph: RosGraph, ros1: Ros1) -> None:
    node = graph.node("/one", ["/chatter"])
    hearing = ros1.subscribe("/chatter", keep=1)
    ros1.look()
    node.wait_for_subscriber("/chatter")
    node.publish("/chatter", b"first")
    node.publish("/chatter", b"second")
    kept: list[bytes] = []
    until(lambda: kept.extend(hearing.samples().payloads) or b"second" in kept, "it is kept")
    assert hearing.samples().payloads == ()


def test_stamps_are_read_of_types_that_begin_with_a_header(graph: RosGraph, ros1: Ros1) -> None:
    node = graph.node("/camera", ["/image"], fields=STAMPED)
    hearing = ros1.subscribe("/image")
    ros1.look()
    node.wait_for_subscriber("/image")
    node.publish("/image", struct.pack("<IIII", 1, 5, 500_000_000, 0) + bytes(200_000))
    until(lambda: hearing.samples().messages, "the message is heard")
    found = hearing.samples()
    assert (found.stamp, found.size, found.payloads) == (5.5, 200_016, ())


def test_a_publisher_that_left_is_heard_no_more(graph: RosGraph, ros1: Ros1) -> None:
    """The connection is closed, so a topic that nobody publishes costs nobody anything."""
    node = graph.node("/talker", ["/chatter"])
    hearing = ros1.subscribe("/chatter")
    ros1.look()
    node.wait_for_subscriber("/chatter")
    graph.master.publishers.clear()
    ros1.look()
    assert node.wait_for_end("/chatter")
    before = hearing.samples().messages
    node.publish("/chatter", TEXT)
    assert hearing.samples().messages == before


def test_a_closed_topic_is_heard_no_more(graph: RosGraph, ros1: Ros1) -> None:
    """It takes leave of the master and of its publishers."""
    node = graph.node("/talker", ["/chatter"])
    hearing = ros1.subscribe("/chatter")
    ros1.look()
    node.wait_for_subscriber("/chatter")
    hearing.close()
    assert node.wait_for_end("/chatter")
    assert [method for method, _ in graph.master.calls] == [
        "registerSubscriber",
        "unregisterSubscriber",
    ]
    hearing.follow([node.uri])
    assert node.links["/chatter"] == 1, "a late word of the master connects it again"


def test_closing_the_half_ends_every_topic(graph: RosGraph, ros1: Ros1) -> None:
    node = graph.node("/talker", ["/chatter"])
    ros1.subscribe("/chatter")
    ros1.look()
    node.wait_for_subscriber("/chatter")
    ros1.close()
    assert node.wait_for_end("/chatter")
    assert graph.master.calls[-1][0] == "unregisterSubscriber"


def test_the_master_tells_of_new_publishers(graph: RosGraph, ros1: Ros1) -> None:
    """By the slave API, between two looks."""
    from xmlrpc.client import ServerProxy

    ros1.subscribe("/chatter")
    graph.node("/listener", subscribes=["/chatter"])
    ros1.look()
    late = graph.program(["/chatter"])
    api = graph.master.nodes["/ros_exporter"]
    with ServerProxy(api) as slave:
        assert slave.getSubscriptions("/m") == [1, "", [["/chatter", "*"]]]
        assert slave.getPid("/m")[0] == 1
        assert slave.getMasterUri("/m")[2] == graph.master.uri
        assert slave.requestTopic("/m", "/chatter", [])[0] == 0
        assert slave.shutdown("/m", "new node registered with same name")[0] == 1
        slave.publisherUpdate("/master", "/chatter", [late.uri])
        slave.publisherUpdate("/master", "/unknown", [late.uri])
    late.wait_for_subscriber("/chatter")


def test_a_publisher_that_comes_back_is_heard_again(graph: RosGraph, ros1: Ros1) -> None:
    """A connection that ends is tried again, without a word of the master."""
    node = graph.node("/talker", ["/chatter"])
    hearing = ros1.subscribe("/chatter")
    ros1.look()
    node.wait_for_subscriber("/chatter")
    node.hang_up("/chatter")
    node.wait_for_subscriber("/chatter")
    node.publish("/chatter", TEXT)
    until(lambda: hearing.samples().messages == 1, "it is heard on the new connection")


def test_a_restarted_master_is_registered_with_again(graph: RosGraph, ros1: Ros1) -> None:
    """It knows nobody; the next look finds that out."""
    ros1.subscribe("/chatter")
    ros1.look()
    graph.master.subscribers.clear()
    graph.node("/talker", ["/chatter"])
    ros1.look()
    assert graph.master.subscribers["/chatter"] == ["/ros_exporter"]


def test_a_topic_that_is_refused_keeps_no_other_from_being_heard(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = graph.master.registerSubscriber

    def register(caller: str, topic: str, kind: str, uri: str) -> list[object]:
        return [-1, "no name", 0] if topic == "bad" else real(caller, topic, kind, uri)

    monkeypatch.setattr(graph.master, "registerSubscriber", register, raising=False)
    node = graph.node("/talker", ["/chatter"])
    ros1.subscribe("bad")
    ros1.subscribe("/chatter")
    ros1.look()
    node.wait_for_subscriber("/chatter")


@pytest.mark.parametrize("answer", [[-1, "no", 0], [1, "", []], [1, "", ["TCPROS", "x", "y"]], "?"])
def test_a_publisher_that_says_nothing_of_use_is_asked_again(
    graph: RosGraph, ros1: Ros1, answer: object
) -> None:
    """It may still be starting."""
    node = graph.node("/talker", ["/chatter"])
    asked = threading.Event()

    def request(*_: object) -> object:
        asked.set()
        return answer

    node.requestTopic = request  # type: ignore[method-assign, assignment]
    ros1.subscribe("/chatter")
    ros1.look()
    assert asked.wait(30)
    del node.requestTopic
    node.wait_for_subscriber("/chatter")


def test_a_publisher_that_is_silent_is_asked_again(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its deadline is a few seconds, and it holds nobody else up."""
    silent, connect_node, asked = graph.serve_silence(), ros1_topic.connect_node, list[str]()

    def connect(uri: str, caller: str, seconds: float) -> Any:
        assert seconds == ros1_topic._ANSWER
        asked.append(uri)
        return connect_node(uri, caller, 0.2 if uri == silent else 60)

    monkeypatch.setattr(ros1_topic, "connect_node", connect)
    node = graph.node("/talker", ["/chatter"])
    graph.master.add("/silent", silent, ["/chatter"])
    hearing = ros1.subscribe("/chatter")
    ros1.look()
    node.wait_for_subscriber("/chatter")
    node.publish("/chatter", TEXT)
    until(lambda: hearing.samples().messages == 1, "the other publisher is heard")
    until(lambda: asked.count(silent) > 1, "the silent one is asked again")


def test_a_lost_word_is_no_lost_master(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is asked a second time before it is said to be away."""
    answers = [lambda caller: "?", graph.master.getPid]
    monkeypatch.setattr(
        graph.master, "getPid", lambda caller: answers.pop(0)(caller), raising=False
    )
    found = ros1.look()
    assert found.master is not None
    assert found.master.up


def test_a_message_that_is_too_large_is_counted_and_not_kept(
    graph: RosGraph, ros1: Ros1, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros1_topic, "LARGEST_KEPT", 10)
    node = graph.node("/camera", ["/image"])
    hearing = ros1.subscribe("/image", keep=5)
    ros1.look()
    node.wait_for_subscriber("/image")
    node.publish("/image", bytes(5000))
    node.publish("/image", b"small")
    kept: list[bytes] = []
    until(lambda: kept.extend(hearing.samples().payloads) or b"small" in kept, "it is kept")
    assert kept == [b"small"]
    assert hearing.samples().size == 5005


# -- nodes that answer anything --


@contextmanager
def answering(body: bytes, length: int | None = None) -> Iterator[str]:
    """Serve one answer to every request, with the length that it claims to have; yields the URI."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.send_header("Content-Length", str(len(body) if length is None else length))
            self.end_headers()
            with suppress(OSError):
                self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        thread.join()


def answer(value: object) -> bytes:
    return xmlrpc.client.dumps((value,), methodresponse=True).encode()


NESTED = b"<value>" + b"<array><data><value>" * 20_000 + b"</value></data></array>" * 20_000
BAD_ANSWERS = [
    (b"", 2**20 + 1),
    (b"", 4_000_000_000),
    (b"", -1),
    (b"<methodResponse>" + NESTED + b"</methodResponse>", None),
    (answer([1, "", [[["/t"], "x"], 7]]), None),
    (answer([1, "", 7]), None),
    (answer([1, "", [[["/t", "no", [["1", "x", "y", "z"]]]], 5]]), None),
    (answer([1, "", {"a": [1]}]), None),
]


@pytest.mark.parametrize(("body", "length"), BAD_ANSWERS)
def test_a_nodes_answer_concerns_that_node_alone(
    graph: RosGraph, ros1: Ros1, body: bytes, length: int | None
) -> None:
    """Endless, nested, or nonsense: the others' metrics are there, and so is the look."""
    graph.node("/good", ["/chatter"])
    with answering(body, length) as uri:
        graph.master.add("/bad", uri, ["/t"], [])
        found = nodes(ros1.look())
    assert found["/good"].up
    assert found["/bad"].registered


@pytest.mark.parametrize("uri", ["http://10.0.0.1:99999/", "http://a..b:1/", "http://h:x/", ""])
def test_an_address_that_no_socket_has_concerns_its_node_alone(
    graph: RosGraph, ros1: Ros1, uri: str
) -> None:
    graph.node("/good", ["/chatter"])
    graph.master.add("/bad", uri, ["/t"], [])
    found = nodes(ros1.look())
    assert (found["/good"].up, found["/bad"].up) == (True, False)
