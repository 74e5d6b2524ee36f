"""What a page draws of the ROS graph, and what stays when a node has gone from it."""

from __future__ import annotations

from typing import Any

from rigel_graph.drawing import make_picture
from rigel_graph.problems import find_problems
from rigel_graph.types import GraphNode, GraphService, GraphTopic, RosGraph
from rigel_ui.boxes import describe, keep_lost, list_away, make_boxes, make_topics
from tests.support.page import node

TALKER = GraphNode("/talker", "robot", "talker-1", "talker")
LISTENER = GraphNode("/listener", "edge", "listener-1", "listener")
CHATTER = GraphTopic("/chatter", "std_msgs/String", ("/talker",), ("/listener",), rate=9.96)


def draw(graph: RosGraph) -> Any:
    return make_picture(graph, find_problems(graph))


def boxes(nodes: list[dict[str, Any]], graph: RosGraph | None) -> dict[str, Any]:
    entries = {one["workload"]: one for one in nodes}
    return make_boxes(entries, graph, None if graph is None else draw(graph))


def test_without_a_graph_each_node_has_a_box() -> None:
    """But the exporter, which only looks at the others."""
    found = boxes([node("/talker"), node("/ros-exporter", helper=True)], None)
    assert [(key, box["machine"]) for key, box in found.items()] == [("box//talker", "robot")]


def test_nodes_of_the_graph_have_boxes_on_their_machines() -> None:
    """Several of one pod, one that is not of the release, and one that is in no graph."""
    second = GraphNode("/talker_helper", "robot", "talker-1", "talker")
    laptop = GraphNode("/rviz", address="10.1.1.1")
    found = boxes([node("/talker"), node("/imu")], RosGraph((TALKER, second, laptop), (CHATTER,)))
    assert {key: (box["workload"], box["machine"]) for key, box in found.items()} == {
        "box//talker": ("talker", "robot"),
        "box//talker_helper": ("talker", "robot"),
        "box//rviz": ("", "outside the release"),
        "box//listener": ("", "outside the release"),  # an end of a topic that has just left
        "box//imu": ("imu", "robot"),
    }


def test_a_box_is_where_its_pod_is_now() -> None:
    """The graph was read before."""
    assert (
        boxes([node("/talker", machine="edge")], RosGraph((TALKER,)))["box//talker"]["machine"]
        == "edge"
    )


def test_roscore_has_no_box() -> None:
    """It is in no connection of the graph; the list of nodes has it."""
    log = GraphNode("/rosout", "robot", "ros-master-1", "ros-master")
    found = boxes([node("/talker"), node("ros-master", helper=True)], RosGraph((TALKER, log)))
    assert list(found) == ["box//talker"]


def test_a_box_has_the_services_of_its_node() -> None:
    """But not those that each node has, nor hidden ones."""
    names = ("/talker/get_parameters", "/plan", "/go/_action/send_goal", "/other")
    services = [
        GraphService(name, "a/srv/B", ("/x",) if name == "/other" else ("/talker",))
        for name in names
    ]
    found = boxes([node("/talker")], RosGraph((TALKER,), services=tuple(services)))
    assert found["box//talker"]["services"] == [{"name": "/plan", "type": "a/srv/B"}]


def test_a_removed_node_has_no_box() -> None:
    """Even if the graph that was read last has it."""
    assert "box//talker" not in boxes([node("/listener")], RosGraph((TALKER, LISTENER)))


def test_topics_have_their_ends_and_rates() -> None:
    graph = RosGraph((TALKER, LISTENER), (CHATTER,))
    assert make_topics(graph, draw(graph))["topic//chatter"] == {
        "name": "/chatter",
        "type": "std_msgs/String",
        "rate": "10.0/s",
        "bad": False,
        "from": ["/talker"],
        "to": ["/listener"],
        "lost": [],
    }


def test_a_node_that_is_away_keeps_its_topics() -> None:
    """Marked as lost; until it is back, or is no longer expected."""
    whole = RosGraph((TALKER, LISTENER), (CHATTER,))
    before = make_topics(whole, draw(whole))
    for left in (
        RosGraph((LISTENER,), (GraphTopic("/chatter", subscribers=("/listener",)),)),
        RosGraph((LISTENER,)),
    ):
        during = keep_lost(before, make_topics(left, draw(left)), {"/talker"})
        kept = during["topic//chatter"]
        assert (kept["from"], kept["lost"]) == (["/talker"], ["/talker"])
        again = keep_lost(during, make_topics(left, draw(left)), {"/talker"})
        assert again == during
        assert keep_lost(during, before, set()) == before
        if not left.topics:
            assert kept["rate"] == "", "nothing is sent any more"
        gone = keep_lost(during, make_topics(left, draw(left)), set())
        assert "/talker" not in gone.get("topic//chatter", {"from": []})["from"]


def test_the_dot_is_that_of_the_graph_and_does_not_change_with_states() -> None:
    """A page lays its graph out again only if nodes, machines or connections are others."""
    graph = RosGraph((TALKER, LISTENER), (CHATTER,))
    topics = make_topics(graph, draw(graph))
    calm = describe(boxes([node("/talker"), node("/listener", machine="edge")], graph), topics)
    assert 'subgraph cluster_1 {\n    label="robot"' in calm
    assert '"node /talker" -> "topic /chatter"' in calm
    assert '"topic /chatter" -> "node /listener"' in calm
    nodes = [node("/talker", "crashed", cause="no device"), node("/listener", machine="edge")]
    slower = {key: {**topic, "rate": "1.0/s", "bad": True} for key, topic in topics.items()}
    assert describe(boxes(nodes, graph), slower) == calm
    assert describe(boxes(nodes[1:], RosGraph((LISTENER,))), topics) != calm


def test_a_task_that_is_done_is_not_expected_back() -> None:
    """Its topics go with it; those of a node that crashes, or has not registered yet, stay."""
    states = {"/a": "ready", "/b": "crashed", "/once": "done", "/late": "ready", "/runs": "ready"}
    entries = {name: node(name, state) for name, state in states.items()}
    assert list_away(entries, {"/a", "/b", "/runs"}) == {"/b", "/late"}
