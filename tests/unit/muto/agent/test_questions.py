"""Questions are answered in the shapes of Muto's ROS 1 generation."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_graph.types import GraphNode, GraphService, GraphTopic, RosGraph
from rigel_k8s.errors import UserError
from rigel_muto.agent.commands import Query
from rigel_muto.execution.questions import NOT_FOUND, answer

STRING = "std_msgs/String"
GRAPH = RosGraph(
    nodes=(
        GraphNode("/gone", registered=False, up=False),
        GraphNode("/listener", address="10.0.0.2"),
        GraphNode("/talker", address="10.0.0.1"),
    ),
    topics=(
        GraphTopic("/chatter", STRING, ("/talker",), ("/listener",)),
        GraphTopic("/quiet", STRING, (), ("/listener",)),
    ),
    services=(GraphService("/talker/set", providers=("/talker",)),),
)
TALKER = {
    "name": "/talker",
    "pubs": [{"topic": "/chatter", "type": STRING}],
    "subs": [],
    "services": ["/talker/set"],
}


@pytest.mark.parametrize(
    ("kind", "arguments", "expected"),
    [
        (
            "ros/topic",
            {},
            {
                "pubs": [["/chatter", STRING, ["/talker"]]],
                "subs": [["/chatter", STRING, ["/listener"]], ["/quiet", STRING, ["/listener"]]],
            },
        ),
        (
            "ros/topic/info",
            {"topic": "chatter"},
            {
                "topic": "/chatter",
                "types": STRING,
                "pubs": [{"publisher": "/talker", "api": "10.0.0.1"}],
                "subs": [{"subscriber": "/listener", "api": "10.0.0.2"}],
            },
        ),
        ("ros/topic/info", {"topic": "/nothing"}, NOT_FOUND),
        ("ros/node/info", {"node": "/talker"}, TALKER),
        ("ros/node/info", {"node": "/gone"}, NOT_FOUND),
    ],
)
def test_answers(kind: Any, arguments: dict[str, Any], expected: Any) -> None:
    assert answer(Query(kind, arguments), GRAPH) == expected


def test_nodes_that_are_not_registered_are_not_there() -> None:
    nodes = answer(Query("ros/node"), GRAPH)["nodes"]
    assert [node["name"] for node in nodes] == ["/listener", "/talker"]
    assert nodes[1]["info"] == TALKER


@pytest.mark.parametrize("arguments", [{}, {"topic": ""}, {"topic": 1}])
def test_a_question_without_its_argument_is_refused(arguments: dict[str, Any]) -> None:
    with pytest.raises(UserError, match="topic"):
        answer(Query("ros/topic/info", arguments), GRAPH)
