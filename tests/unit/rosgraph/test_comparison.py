"""What an update did to a ROS graph: one small case for each line, and for each silence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import pytest

from rigel_graph.comparison import Comparison, compare, generalise, is_tool
from rigel_graph.types import GraphNode, GraphService, GraphTopic, Mismatch, RosGraph

SCAN, CLOUD = "sensor_msgs/LaserScan", "sensor_msgs/PointCloud2"


def node(name: str, **more: Any) -> GraphNode:
    """Return a node in a pod of the release, whose workload has the node's name."""
    workload = name.rpartition("/")[2]
    return GraphNode(name, "n1", f"{workload}-1", workload, **more)


def graph(
    *nodes: GraphNode | str,
    topics: Mapping[str, tuple[str, str]] | None = None,
    services: Mapping[str, str] | None = None,
    **more: GraphTopic,
) -> RosGraph:
    """Return a graph; topics are publishers and subscribers as words, services their providers."""
    made = [node(one) if isinstance(one, str) else one for one in nodes]
    found = [
        GraphTopic(name, SCAN, tuple(senders.split()), tuple(hearers.split()))
        for name, (senders, hearers) in (topics or {}).items()
    ]
    offered = [
        GraphService(name, providers=tuple(by.split())) for name, by in (services or {}).items()
    ]
    return RosGraph(tuple(made), (*found, *more.values()), tuple(offered))


def worse(before: RosGraph, after: RosGraph, *removed: str) -> list[str]:
    return list(compare(before, after, removed=removed).worse)


def changed(before: RosGraph, after: RosGraph, *removed: str) -> list[str]:
    found = compare(before, after, removed=removed)
    assert found.worse == ()
    return list(found.changed)


ROBOT = graph(
    "/lidar",
    "/planner",
    topics={"/scan": ("/lidar", "/planner"), "/rosout": ("/lidar /planner", "")},
    services={"/lidar/reset": "/lidar", "/lidar/get_loggers": "/lidar"},
)


def test_the_same_graph_is_neither_worse_nor_changed() -> None:
    """Whatever pods and machines its nodes are in now."""
    moved = [attrs.evolve(one, machine="n2", pod=f"{one.pod}x") for one in ROBOT.nodes]
    assert compare(ROBOT, attrs.evolve(ROBOT, nodes=tuple(moved))) == Comparison()


def test_a_lost_publisher_is_told_by_its_topic() -> None:
    after = graph("/lidar", "/planner", topics={"/scan": ("", "/planner")}, services={})
    assert worse(ROBOT, after) == [
        "/scan had 1 publisher, now 0",
        "the service /lidar/reset no longer exists",
    ]


def test_a_topic_that_is_gone_has_lost_both_ends() -> None:
    before = graph("/a", "/b", "/c", topics={"/scan": ("/a /b", "/c")})
    assert worse(before, graph("/a", "/b", "/c")) == [
        "/scan had 2 publishers, now 0",
        "/scan had 1 subscriber, now 0",
    ]


def test_fewer_are_worse_than_before() -> None:
    before = graph("/a", "/b", topics={"/t": ("/a /b", "/a /b")}, services={"/s": "/a /b"})
    after = graph("/a", "/b", topics={"/t": ("/b", "/a")}, services={"/s": "/a"})
    assert worse(before, after) == [
        "/t had 2 publishers, now 1",
        "/t had 2 subscribers, now 1",
        "the service /s had 2 providers, now 1",
    ]


def test_another_node_may_take_a_topic_over() -> None:
    before = graph("/a", "/b", topics={"/t": ("/a", "/b")})
    assert worse(before, graph("/a", "/b", topics={"/t": ("/b", "/a")})) == []


def test_a_corrected_name_of_a_topic_is_no_loss() -> None:
    """No one has published the wrong one. A publisher that no one heard is still missed."""
    before = graph(
        "/lidar", "/planner", topics={"/scam": ("", "/planner"), "/scan": ("/lidar", "")}
    )
    after = graph("/lidar", "/planner", topics={"/scan": ("/lidar", "/planner")})
    assert changed(before, after) == ["/scam has no subscriber now, it had no publisher"]
    unheard = graph("/lidar", topics={"/scam": ("/lidar", "")})
    assert worse(unheard, graph("/lidar")) == ["/scam had 1 publisher, now 0"]
    fewer = graph("/a", "/b", topics={"/scam": ("", "/a /b")})
    after = graph("/a", "/b", topics={"/scam": ("", "/b")})
    assert worse(fewer, after) == ["/scam had 2 subscribers, now 1"]


def test_a_missing_node_is_named_and_so_are_its_topics() -> None:
    """What each node has, its log say, is not worth a line."""
    after = graph("/planner", topics={"/scan": ("", "/planner"), "/rosout": ("/planner", "")})
    assert worse(ROBOT, after) == [
        "/lidar is no longer in the graph",
        "/scan had 1 publisher, now 0",
        "the service /lidar/reset no longer exists",
    ]


def test_a_problem_that_explains_a_missing_node_comes_in_its_place() -> None:
    before, gone = graph("/lidar"), node("/lidar", registered=False, up=False)
    (line,) = worse(before, graph(gone))
    assert line.startswith("/lidar is not in the graph: its pod lidar-1 is ready")


@pytest.mark.parametrize(
    ("broken", "line"),
    [
        ({"up": False}, "/lidar does not answer"),
        ({"ready": False}, "/lidar: its pod lidar-1 is not ready"),
    ],
)
def test_a_new_problem_is_worse_and_an_old_one_is_not(broken: Any, line: str) -> None:
    bad = graph(node("/lidar", **broken))
    assert worse(graph("/lidar"), bad) == [line]
    assert worse(bad, bad) == []
    assert worse(bad, graph("/lidar")) == []


def test_problems_of_removed_nodes_and_of_tools_are_no_news() -> None:
    """A removed node may linger without answering, and so may a tool that a person has started."""
    before = graph("/base", "/lidar")
    broken = {"up": False}
    assert worse(before, graph("/base", node("/lidar", **broken)), "/lidar") == []
    tool = node("/rostopic_42_1700000000000", **broken)
    assert worse(before, graph("/base", "/lidar", tool)) == []
    assert worse(before, graph("/base", node("/lidar", **broken))) == ["/lidar does not answer"]


def test_a_node_that_was_not_there_before_is_not_missed() -> None:
    before = graph(node("/lidar", registered=False, up=False), "/planner")
    assert worse(before, graph("/planner")) == []


def test_types_that_no_longer_fit_are_worse() -> None:
    """Also where the other end is not the release's."""
    rviz = GraphNode("/rviz", address="10.0.0.7")
    before = graph("/lidar", rviz, topics={"/scan": ("/lidar", "/rviz")})
    topic = GraphTopic("/scan", CLOUD, ("/lidar",), ("/rviz",), (Mismatch("/rviz", SCAN),))
    after = graph("/lidar", rviz, scan=topic)
    assert worse(before, after) == [f"/rviz uses /scan as {SCAN}, the others as {CLOUD}"]
    assert worse(after, after) == []


def test_a_type_that_all_ends_have_changed_is_a_change() -> None:
    topic = GraphTopic("/scan", CLOUD, ("/lidar",), ("/planner",))
    before = graph("/lidar", "/planner", topics={"/scan": ("/lidar", "/planner")})
    after = graph("/lidar", "/planner", scan=topic)
    assert changed(before, after) == [f"/scan has the type {CLOUD} now, it was {SCAN}"]
    unknown = graph("/lidar", "/planner", scan=attrs.evolve(topic, type=""))
    assert changed(before, unknown) == []


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        (10.0, 4.9, "/scan had 10 messages/s, now 4.9"),
        (30.0, 0.0, "/scan had 30 messages/s, now 0"),
        (10.0, 5.0, None),
        (0.9, 0.1, None),
        (10.0, None, None),
        (None, 1.0, None),
        (1.0, 40.0, None),
    ],
)
def test_a_rate_that_has_halved_is_worse(
    before: float | None, after: float | None, line: str | None
) -> None:
    """Where both are known and the old one was at least one a second."""
    topic = GraphTopic("/scan", SCAN, ("/lidar",), ("/planner",))
    graphs = [
        graph("/lidar", "/planner", scan=attrs.evolve(topic, rate=rate)) for rate in (before, after)
    ]
    assert worse(*graphs) == ([line] if line else [])


def test_a_rate_that_fell_with_its_publishers_is_told_once() -> None:
    """And not at all where a publisher was removed."""
    many = GraphTopic("/t", SCAN, ("/a", "/b"), ("/c",), rate=20.0)
    few = GraphTopic("/t", SCAN, ("/a",), ("/c",), rate=9.0)
    before, after = graph("/a", "/b", "/c", t=many), graph("/a", "/c", t=few)
    assert worse(before, after) == [
        "/b is no longer in the graph",
        "/t had 2 publishers, now 1",
    ]
    assert changed(before, after, "/b") == ["/b is removed"]


def test_what_is_new_is_a_change() -> None:
    """A new subscriber without a publisher too: it may wait for a joystick."""
    before = graph("/planner")
    after = graph("/planner", "/imu", topics={"/imu": ("/imu", ""), "/joy": ("", "/planner")})
    assert changed(before, after) == [
        "/imu is new",
        "/imu is a new topic",
        "/joy is a new topic",
        "/joy has no publisher; subscribed by /planner",
    ]


def test_removed_nodes_are_not_missing_nor_is_what_only_they_had() -> None:
    after = graph("/planner", topics={"/scan": ("", "/planner")})
    assert changed(ROBOT, after, "/lidar") == [
        "/lidar is removed",
        "/scan has no publisher; subscribed by /planner",
    ]


def test_a_removed_node_may_linger() -> None:
    """A master knows a node that was killed until someone clears it."""
    dead = GraphNode("/lidar", up=False)
    after = graph(dead, "/planner", topics={"/scan": ("/lidar", "/planner")})
    assert worse(ROBOT, after, "/lidar") == []
    assert changed(ROBOT, ROBOT, "/lidar") == []


def test_who_is_outside_of_the_release_may_go() -> None:
    """A laptop's teleop and rviz are not the update's business; they do not replace ours either."""
    teleop, rviz = GraphNode("/teleop", address="10.0.0.7"), GraphNode("/rviz", address="10.0.0.7")
    before = graph(
        *("/base", teleop, rviz),
        topics={"/cmd_vel": ("/teleop", "/base"), "/odom": ("/base", "/rviz")},
    )
    after = graph("/base", topics={"/cmd_vel": ("", "/base"), "/odom": ("/base", "")})
    assert worse(before, after) == []
    deaf = attrs.evolve(teleop, up=False)
    assert worse(before, attrs.evolve(before, nodes=(node("/base"), deaf, rviz))) == []
    replaced = graph("/base", teleop, rviz, topics={"/odom": ("/teleop", "/rviz")})
    assert "/odom had 1 publisher, now 0" in worse(before, replaced)


def test_a_node_whose_place_is_unknown_now_is_still_there() -> None:
    """Its address may come later than its name."""
    after = attrs.evolve(ROBOT, nodes=(GraphNode("/lidar"), node("/planner")))
    assert worse(ROBOT, after) == []


def test_anonymous_nodes_are_compared_without_their_numbers() -> None:
    """rospy's PID and milliseconds, roscpp's nanoseconds, tf2's address."""
    names = "/talker_12_1700000000000", "/talker_9_1700000000001"
    other = "/talker_11_1800000000000", "/talker_10_1800000000001"
    topic = GraphTopic("/chatter", SCAN)
    before = graph(*(node(n) for n in names), t=attrs.evolve(topic, publishers=names))
    after = graph(*(node(n) for n in other), t=attrs.evolve(topic, publishers=other))
    assert compare(before, after) == Comparison()
    fewer = graph(node(other[0]), t=attrs.evolve(topic, publishers=other[:1]))
    assert worse(before, fewer) == [
        "/talker: there were 2 nodes of this name, now 1",
        "/chatter had 2 publishers, now 1",
    ]


@pytest.mark.parametrize(
    ("name", "general"),
    [
        ("/talker_12_1700000000000", "/talker"),
        ("/talker_1700000000000000000", "/talker"),
        ("/a/talker_12_1700000000000/set", "/a/talker/set"),
        ("/transform_listener_impl_5581ff3c6a80", "/transform_listener_impl"),
        ("/camera_1", "/camera_1"),
        ("/robot_2/scan", "/robot_2/scan"),
        ("/front_facade", "/front_facade"),
    ],
)
def test_what_is_made_at_start_is_no_part_of_a_name(name: str, general: str) -> None:
    assert generalise(name) == general


def test_topics_of_anonymous_nodes_are_compared_without_their_numbers() -> None:
    graphs = []
    for number in (1700000000000, 1800000000000):
        name = f"/talker_1_{number}"
        services = {f"{name}/reset": name}
        graphs.append(graph(node(name), topics={f"{name}/state": (name, "")}, services=services))
    assert compare(*graphs) == Comparison()


def test_the_pods_name_in_a_nodes_is_no_part_of_it() -> None:
    """roslaunch's anon puts the host's name into it."""
    graphs = []
    for pod in ("lidar-5f6d7c8b9-zzx2v", "lidar-7c9b8d6f5-hjklm"):
        name = f"/driver_{pod.replace('-', '_')}_12_8234567890123"
        one = GraphNode(name, "n1", pod, "lidar")
        graphs.append(graph(one, topics={"/scan": (name, "")}))
    assert compare(*graphs) == Comparison()


@pytest.mark.parametrize(
    ("name", "tool"),
    [
        ("/rostopic_123_1700000000000", True),
        ("/record_1700000000000000000", True),
        ("/rqt_gui_py_node_4711", True),
        ("/_ros2cli_daemon_0_ab", True),
        ("/robot/_hidden", True),
        ("/launch_ros_7", True),
        ("/ros_exporter", True),
        ("/robot/foxglove", True),
        ("/foxglove_camera", False),
        ("/record", False),
        ("/rviz", False),
        ("/rosbridge_websocket", False),
        ("/play_2", False),
        ("/rostopic_42_1700000000000", True),  # a small process id, as in a pod
    ],
)
def test_tools_are_known_by_the_names_they_make(name: str, tool: bool) -> None:  # noqa: FBT001
    assert is_tool(name) is tool


def test_tools_in_the_releases_pods_may_go() -> None:
    """`rigel exec lidar -- rostopic echo /scan` ends with its pod."""
    name = "/rostopic_123_1700000000000"
    tool = GraphNode(name, "n1", "lidar-1", "lidar")
    before = graph("/lidar", tool, topics={"/scan": ("/lidar", name)})
    assert compare(before, graph("/lidar", topics={"/scan": ("/lidar", "")})) == Comparison()


def test_an_action_is_one_thing() -> None:
    """Its status, feedback and services come and go together."""
    topics = {f"/nav/_action/{part}": ("/nav", "/ui") for part in ("feedback", "status")}
    services = {f"/nav/_action/{part}": "/nav" for part in ("send_goal", "get_result")}
    before = graph("/nav", "/ui", topics=topics, services=services)
    gone = dict.fromkeys(topics, ("", "/ui"))
    assert worse(before, graph("/nav", "/ui", topics=gone)) == [
        "the action /nav had 1 publisher, now 0"
    ]


def test_a_lifecycle_node_may_begin_to_hand_over() -> None:
    """Then two of its services have another name in each pod; nothing is worse, nor changed."""
    plain = {f"/a/{name}": "/a" for name in ("change_state", "get_available_transitions")}
    own = {name.replace("/a/", "/a/_rigel_k8s/t1_pod/"): "/a" for name in plain}
    before, after = graph("/a", services=plain), graph("/a", services=own)
    assert compare(before, after) == compare(after, before) == Comparison()
