"""What is wrong in a ROS graph: `find_problems`; pure."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.rosgraph.types import GraphNode, GraphProblem, GraphTopic, RosGraph

#: Topics that ROS itself or every tool subscribes to, with or without a publisher.
OPTIONAL_TOPICS = frozenset(
    {"/clock", "/diagnostics", "/parameter_events", "/rosout", "/statistics", "/tf", "/tf_static"}
)


def find_problems(graph: RosGraph) -> tuple[GraphProblem, ...]:
    """Return what is wrong, errors first. A publisher without subscribers is not a problem."""
    found = [problem for node in graph.nodes for problem in check_node(node)]
    found += [problem for topic in graph.topics for problem in check_topic(topic)]
    return tuple(sorted(found, key=lambda problem: not problem.error))


def check_node(node: GraphNode) -> Iterator[GraphProblem]:
    """Yield what is wrong with a node: only the most direct cause."""
    if not node.registered:
        message = f"{node.name} is not in the graph: {explain_missing(node)}"
        yield GraphProblem("missing", message, nodes=(node.name,))
    elif not node.up:
        message = f"{node.name} does not answer"
        yield GraphProblem("no-answer", message, nodes=(node.name,))
    elif not node.ready:
        message = f"{node.name}: its pod {node.pod} is not ready"
        yield GraphProblem("not-ready", message, nodes=(node.name,))


def explain_missing(node: GraphNode) -> str:
    """Return why a node is not in the graph, as far as that is known."""
    if not node.pod:
        return "it has no pod"
    if not node.ready:
        return f"its pod {node.pod} is not ready"
    return f"its pod {node.pod} is ready; check whether its program uses another name"


def check_topic(topic: GraphTopic) -> Iterator[GraphProblem]:
    """Yield what is wrong with a topic."""
    for other in topic.mismatches:
        yield GraphProblem(
            "type",
            f"{other.node} uses {topic.name} as {other.type}, the others as {topic.type}",
            nodes=(other.node,),
            topic=topic.name,
        )
    if topic.subscribers and not topic.publishers and topic.name not in OPTIONAL_TOPICS:
        some = ", ".join(topic.subscribers[:3]) + (", ..." if len(topic.subscribers) > 3 else "")
        yield GraphProblem(
            "no-publisher",
            f"{topic.name} has no publisher; subscribed by {some}",
            nodes=topic.subscribers,
            topic=topic.name,
            error=False,
        )
