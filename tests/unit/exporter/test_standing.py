"""How looks at a graph become metrics: expected and once-seen nodes, masters, bounds."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_exporter.graph import Graph, Master, Node, Topic, Traffic
from rigel_exporter.standing import NODES, REMEMBERED, TOPICS, TRAFFIC, Standing

TALKER = Node("/talker", up=True, registered=True)


def standing(expected: Mapping[str, str] | None = None, **more: object) -> Standing:
    known = more.get("known", {})
    named = more.get("named", ())
    return Standing(expected or {}, known, named, more.get("once", ()))  # type: ignore[arg-type]


def told(standing: Standing, name: str) -> dict[tuple[str, ...], float]:
    """What is told of a metric: the values of its labels -> its value."""
    found = [s for s in standing.samples() if s.name == name]
    values = {tuple(s.labels.values()): s.value for s in found}
    assert len(values) == len(found), "one series is told twice"
    return values


def test_an_expected_node_is_told_before_it_was_ever_seen() -> None:
    made = standing({"/talker": "t", "/lidar": "laser"})
    made.take(Graph(nodes=[TALKER]), 0.0)
    assert told(made, "ros_node_up") == {("/talker", "t"): 1, ("/lidar", "laser"): 0}
    assert told(made, "ros_node_registered") == {("/talker", "t"): 1, ("/lidar", "laser"): 0}


def test_a_node_that_is_cut_off_is_down_if_it_is_expected_in_this_domain() -> None:
    """Others may be in a domain of their own."""
    made = standing({"/talker": "t"})
    alone = [Node(name, up=True, registered=False) for name in ("/talker", "/elsewhere")]
    made.take(Graph(nodes=alone), 0.0)
    assert told(made, "ros_node_up") == {("/talker", "t"): 0, ("/elsewhere", ""): 1}


def test_a_node_that_names_itself_has_its_workload_and_is_not_expected() -> None:
    made = standing(known={"/talker": "t", "/never": "n"})
    made.take(Graph(nodes=[TALKER]), 0.0)
    assert told(made, "ros_node_up") == {("/talker", "t"): 1}


def test_a_node_that_ran_once_is_not_missing_afterwards() -> None:
    made = standing(known={"/talker": "t"}, once=["/talker"])
    made.take(Graph(nodes=[TALKER]), 0.0)
    assert told(made, "ros_node_up") == {("/talker", "t"): 1}
    made.take(Graph(), 1.0)
    assert told(made, "ros_node_up") == {}


def test_a_node_seen_once_is_gone_for_an_hour_and_then_forgotten() -> None:
    made = standing()
    made.take(Graph(nodes=[TALKER]), 0.0)
    made.take(Graph(), REMEMBERED - 1)
    assert told(made, "ros_node_up") == {("/talker", ""): 0}
    made.take(Graph(), REMEMBERED + 1)
    assert told(made, "ros_node_up") == {}


def test_another_process_at_the_same_address_is_a_restart() -> None:
    """At another address it is another pod's, which an update has made."""
    made = standing({"/talker": "t"})
    for process in (("1.1.1.1", "a"), ("1.1.1.1", "a"), (), ("1.1.1.1", "b"), ("2.2.2.2", "c")):
        made.take(Graph(nodes=[TALKER._replace(process=process)]), 0.0)
    assert told(made, "ros_node_restarts_total") == {("/talker", "t"): 1}
    made.take(Graph(nodes=[TALKER._replace(process=("2.2.2.2", "d"))]), 1.0)
    made.take(Graph(), 2.0)
    assert told(made, "ros_node_restarts_total") == {("/talker", "t"): 2}


def test_a_node_whose_process_is_not_known_has_no_count_of_restarts() -> None:
    made = standing()
    made.take(Graph(nodes=[TALKER]), 0.0)
    assert told(made, "ros_node_restarts_total") == {}


def test_an_anonymous_node_is_forgotten_at_once() -> None:
    made = standing()
    made.take(Graph(nodes=[Node("/rostopic_12_1700000000000", up=True, registered=True)]), 0.0)
    made.take(Graph(), 1.0)
    assert told(made, "ros_node_up") == {}


def test_another_process_or_run_is_a_restart_and_a_late_run_id_is_none() -> None:
    """The process id alone cannot tell: containers give the same one again."""
    made = standing()
    looks = [
        (Master(True, 7, ""), 0),
        (Master(True, 7, "a"), 0),
        (Master(False), 0),
        (Master(True, 7, "a"), 0),
        (Master(True, 7, "b"), 1),
        (Master(True, 9, "b"), 2),
        (Master(True, 9, ""), 3),
        (Master(True, 9, "c"), 3),
    ]
    for now, (master, restarts) in enumerate(looks):
        made.take(Graph(master=master), float(now))
        assert told(made, "ros_master_restarts_total") == {(): restarts}
    assert told(made, "ros_master_start_time_seconds") == {(): 6.0}


def test_a_graph_without_a_master_tells_of_none() -> None:
    made = standing()
    made.take(Graph(nodes=[TALKER]), 0.0)
    names = {sample.name for sample in made.samples()}
    assert not {name for name in names if name.startswith("ros_master")}
    assert "ros_node_missing_registrations" not in names


def test_more_than_the_bounds_is_counted_and_not_told() -> None:
    nodes = [Node(f"/n{i}", up=True, registered=True) for i in range(NODES + 5)]
    topics = [Topic(f"/t{i}", "t/T", 1, 0) for i in range(TOPICS + 7)]
    traffic = [Traffic("/n0", f"/t{i}", "published", 1, 1) for i in range(TOPICS)]
    made = standing({"/n204": "last"}, named=["/t506"])
    made.take(Graph(nodes, topics, traffic, dropped={"nodes": 2}), 0.0)
    dropped = told(made, "ros_exporter_dropped")
    assert dropped[("nodes",)] == 7
    assert dropped[("topics",)] == 7
    assert len(told(made, "ros_node_up")) == NODES
    assert len(told(made, "ros_topic_publishers")) == TOPICS
    assert ("/n204", "last") in told(made, "ros_node_up"), "the expected ones first"
    assert ("/t506", "t/T") in told(made, "ros_topic_publishers"), "the named ones first"
    assert len(told(made, "ros_node_topic_bytes_total")) + dropped[("traffic",)] == TOPICS


def test_traffic_has_a_bound_of_its_own() -> None:
    topics = [Topic(f"/t{i}", "t/T", 1, 0) for i in range(10)]
    traffic = [
        Traffic(f"/n{n}", f"/t{t}", "published", 1, 1) for n in range(TRAFFIC) for t in range(2)
    ]
    made = standing()
    made.take(Graph(topics=topics, traffic=traffic), 0.0)
    assert told(made, "ros_exporter_dropped")[("traffic",)] == TRAFFIC


def test_nodes_that_went_stay_within_the_bound() -> None:
    made = standing()
    made.take(Graph([Node(f"/a{i}", up=True, registered=True) for i in range(NODES)]), 0.0)
    made.take(Graph([Node(f"/b{i}", up=True, registered=True) for i in range(NODES)]), 1.0)
    assert len(told(made, "ros_node_up")) == NODES
