"""ROS 2: what the processes of nodes have noted becomes metrics, without a participant."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Any

import pytest

from rigel_exporter.config import Config
from rigel_exporter.graph import Graph, Topic
from rigel_exporter.listening import Listening
from rigel_exporter.notes import Counters
from rigel_exporter.ros2 import Ros2
from rigel_exporter.standing import Standing
from tests.support.notes import (
    NOW,
    SECOND,
    STRING,
    answer,
    entity,
    process,
    publisher,
    serve,
    subscription,
)

TALKER, LISTENER = "/talker", "/listener"


def look(*pods: Mapping[str, Any]) -> Graph:
    """The graph that some pods show."""
    return Counters().take({str(number): pod for number, pod in enumerate(pods)})


def talker(count: int, **fields: Any) -> Mapping[str, Any]:
    """A pod with a talker."""
    part = publisher(TALKER, "/chatter", count, matched=1, longest=SECOND // 10)
    return answer(process(TALKER, parts=[part], **fields))


def test_topics_have_the_publishers_and_subscribers_of_all_pods() -> None:
    """Services are not topics."""
    parts = [subscription(LISTENER, "/chatter"), entity("service", "/listener/reset", LISTENER)]
    graph = look(talker(1), answer(process(LISTENER, parts=parts)))
    assert graph.topics == [Topic("/chatter", STRING, 1, 1)]
    assert {node.name for node in graph.nodes if node.up} == {TALKER, LISTENER}


def test_a_node_that_was_only_discovered_is_up() -> None:
    """It may have no layer, or be on another machine; tools of the command line do not count."""
    graph = look(talker(1, seen=[TALKER, "/rviz", "/_ros2cli_daemon_0"]))
    assert [node.name for node in graph.nodes] == [TALKER, "/rviz"]


def test_a_node_of_another_process_in_the_same_pod_was_restarted() -> None:
    """By the address of its keeper, and by when the node was made."""
    counters = Counters()
    looks = [("pod", 1), ("pod", 1), ("pod", 2), ("other", 3)]
    found = []
    for place, created in looks:
        own = process(TALKER)
        for one in own["entities"]:
            one["created"] = created
        (node,) = counters.take({place: answer(own)}).nodes
        found.append(node.process)
    assert found == [("pod", "1"), ("pod", "1"), ("pod", "2"), ("other", "3")]


@pytest.mark.parametrize(
    ("seen", "registered"),
    [
        ({"/a": ["/a"], "/b": ["/b", "/c"], "/c": ["/c"]}, ["/b", "/c"]),
        ({"/a": ["/a", "/b"], "/b": ["/b", "/c"], "/c": ["/c"]}, ["/a", "/b", "/c"]),
        ({"/a": ["/a"], "/b": ["/b"]}, ["/a", "/b"]),  # no one knows which of them is cut off
    ],
)
def test_a_node_that_no_other_pod_has_met_is_cut_off(
    seen: dict[str, list[str]], registered: list[str]
) -> None:
    """While others have met each other; one has met another if either has discovered it."""
    graph = look(*(answer(process(name, seen=its)) for name, its in seen.items()))
    assert [node.name for node in graph.nodes if node.registered] == registered
    assert all(node.up for node in graph.nodes)


@pytest.mark.parametrize(
    ("mode", "works"), [(0, True), (1, False), (2, False), (3, True), (4, False)]
)
def test_a_process_that_waits_or_was_replaced_is_not_counted(mode: int, works: bool) -> None:  # noqa: FBT001
    """During a hand-over, a node of one name exists twice, and one of them works."""
    assert bool(look(talker(1, mode=mode)).traffic) is works


def test_counters_go_on_when_a_process_is_replaced() -> None:
    """Prometheus would take a smaller number for a restart; the old one's last 5 count, too."""
    counters, totals = Counters(), []
    pods = [
        {"old": talker(10)},
        {"old": talker(15, mode=4), "new": talker(2, pid=8)},
        {"new": talker(5, pid=8)},
        {},
        {"new": talker(9, pid=8)},
    ]
    for found in pods:
        totals += [part.messages for part in counters.take(found).traffic]
    assert totals == [10, 17, 20, 24]


def test_counters_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nodes with anonymous names come and go for months."""
    monkeypatch.setattr(Counters, "MOST", 2)
    counters = Counters()
    for number in range(5):
        name = f"/talker_{number}"
        counters.take(
            {"pod": answer(process(name, pid=number, parts=[publisher(name, "/chatter", 1)]))}
        )
    assert len(counters._totals) == len(counters._seen) == 2


def samples(graph: Graph, **config: Any) -> dict[str, float]:
    """The metrics of a look at 1000 s: name and the labels that differ, as text."""
    standing = Standing({TALKER: "talker"}, {}, config.get("topics", ()))
    standing.take(graph, 1000.0)
    found = {}
    for sample in standing.samples():
        words = [v for key, v in sample.labels.items() if key not in ("workload", "type")]
        found[" ".join([sample.name, *words])] = sample.value
    return found


def test_gaps_ages_and_partners_become_metrics() -> None:
    """The present silence counts as a gap; bytes are exported only where they are known."""
    part = subscription(
        LISTENER, "/chatter", 3, last=NOW - 4 * SECOND, longest=SECOND, age=SECOND // 4, matched=2
    )
    found = samples(look(talker(7), answer(process(LISTENER, parts=[part]))))
    assert found["ros_node_topic_messages_total /talker /chatter published"] == 7
    assert found["ros_node_topic_longest_gap_seconds /talker /chatter published"] == 0.1
    assert found["ros_node_topic_longest_gap_seconds /listener /chatter received"] == 4
    assert found["ros_node_topic_age_seconds /listener /chatter"] == 0.25
    assert found["ros_node_topic_partners /listener /chatter received"] == 2
    assert not any(name.startswith("ros_node_topic_bytes_total") for name in found)
    assert not any(name.startswith("ros_node_topic_age_seconds /talker") for name in found)


def test_refused_and_dropped_messages_are_counted() -> None:
    """What a process dropped while it waited is there once it works, and only once."""
    part = subscription(LISTENER, "/chatter", 3, refused=2, dropped=9)
    counters = Counters()
    for mode, refused, dropped in ((1, None, None), (0, 2, 9), (0, 2, 9)):
        pod = answer(process(LISTENER, parts=[part], mode=mode))
        found = samples(counters.take({"pod": pod}))
        for what, number in (("refused", refused), ("dropped", dropped)):
            name = f"ros_node_topic_{what}_total /listener /chatter received"
            assert found.get(name) == number


def test_an_executor_that_stands_still_is_measured() -> None:
    """One that waits for work is not: its node has nothing to do."""
    for seconds in (2, 41):
        stuck = process(TALKER, stands=seconds * SECOND)
        found = samples(look(answer(stuck), answer(process(LISTENER))))
        assert found["ros_node_turn_age_seconds /talker"] == seconds
    assert found["ros_node_turn_age_seconds /listener"] == 0


def test_named_topics_have_the_series_that_alerts_use() -> None:
    """All publishers together; one that is published elsewhere is counted where it is heard."""
    other = process("/b", parts=[publisher("/b", "/chatter", 5, last=NOW - 9 * SECOND)])
    parts = [subscription(LISTENER, name, 3, last=NOW - SECOND) for name in ("/chatter", "/far")]
    graph = look(talker(7), answer(other), answer(process(LISTENER, parts=parts)))
    found = samples(graph, topics=["/chatter", "/far", "/absent"])
    assert found["ros_topic_messages_total /chatter"] == 12
    assert found["ros_topic_last_message_timestamp_seconds /chatter"] == 1000
    assert found["ros_topic_messages_total /far"] == 3
    assert found["ros_topic_last_message_timestamp_seconds /far"] == 999
    assert not any("/absent" in name for name in found)


def test_keepers_are_asked_at_all_ports_of_an_address() -> None:
    """Pods of one machine's network share an address, and not every port has a keeper."""
    with serve(talker(7)) as port:
        half = Ros2([f"127.0.0.1:{port - 2}", "no-such-name.invalid:1"], None)
        assert [part.messages for part in half.look().traffic] == [7]
        half.close()


def test_a_port_with_something_else_is_no_keeper() -> None:
    """Its answer, or its silence, does not end the look."""
    with serve({"hello": 1}) as port, socket.create_server(("127.0.0.1", 0)) as silent:
        places = [f"127.0.0.1:{port}", f"127.0.0.1:{silent.getsockname()[1] - 3}"]
        assert Ros2(places, None).look() == Graph(nodes=[], topics=[], traffic=[])


def test_named_topics_are_not_subscribed_to() -> None:
    """An image topic costs nothing; only /diagnostics, /clock and /tf have content to read."""
    half = Ros2([], None)
    listening = Listening(half, Config(ros="2", topics=["/image"], diagnostics=True))
    assert list(listening._subscribers) == ["/diagnostics"]
    assert list(listening.samples(0.0)) == []
