"""What is wrong in a ROS graph: `find_problems`; pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches

from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_k8s.problems import Problem

#: Topics that ROS itself or every tool subscribes to, with or without a publisher.
OPTIONAL_TOPICS = frozenset(
    {"/clock", "/diagnostics", "/parameter_events", "/rosout", "/statistics", "/tf", "/tf_static"}
)

#: Seconds after which an executor that does not look for work is worth a line.
STANDS = 10.0


def find_problems(graph: RosGraph) -> tuple[Problem, ...]:
    """Return what is wrong, errors first. A publisher without subscribers is not a problem.

    The subjects of a problem are nodes; that of a topic has the topic in its path.
    """
    problems = [problem for node in graph.nodes for problem in check_node(node)]
    published = [topic for topic in graph.topics if topic.publishers and topic.is_public]
    problems += [found for topic in graph.topics for found in check_topic(topic, published)]
    return tuple(sorted(problems, key=lambda problem: not problem.is_error))


def topic_of(problem: Problem) -> str:
    """Return the topic that a problem is about, "" for one of a node."""
    return str(problem.path[1]) if problem.path else ""


def check_node(node: GraphNode) -> Iterator[Problem]:
    """Yield what is wrong with a node: only the most direct cause."""
    subjects = (node.name,)
    if not node.registered:
        message = f"{node.name} is not in the graph: {explain_missing(node)}"
        remedy = "" if node.pod and node.ready else "see `rigel status` and `rigel logs NODE`"
        yield Problem((), message, "missing", remedy=remedy, subjects=subjects)
    elif not node.up:
        remedy = "restart its pod: it hangs, or it has gone"
        yield Problem(
            (), f"{node.name} does not answer", "no-answer", remedy=remedy, subjects=subjects
        )
    elif node.stands > STANDS:
        yield describe_stand(node.name, node.stands)
    elif not node.ready:
        message = f"{node.name}: its pod {node.pod} is not ready"
        remedy = "`rigel status` has the reason"
        yield Problem((), message, "not-ready", remedy=remedy, subjects=subjects)


def describe_stand(node: str, seconds: float) -> Problem:
    """Return the problem of a node whose executor does not look for work."""
    message = f"{node}: no turn of its executor for {seconds:.0f} s"
    remedy = "find the callback that does not return"
    return Problem((), message, "stuck", "warning", remedy=remedy, subjects=(node,))


def explain_missing(node: GraphNode) -> str:
    """Return why a node is not in the graph, as far as that is known."""
    if not node.pod:
        return "it has no pod"
    if not node.ready:
        return f"its pod {node.pod} is not ready"
    return f"its pod {node.pod} is ready; check whether its program uses another name"


def check_topic(topic: GraphTopic, published: Sequence[GraphTopic]) -> Iterator[Problem]:
    """Yield what is wrong with a topic; its name may be misspelt if a published one is similar."""
    path = ("topics", topic.name)
    for other in topic.mismatches:
        message = f"{other.node} uses {topic.name} as {other.type}, the others as {topic.type}"
        remedy = "build both from the same messages"
        yield Problem(path, message, "type", remedy=remedy, subjects=(other.node,))
    for name in topic.alone:
        message = f"{name} has no partner on {topic.name}, although the topic has others"
        remedy = "compare reliability and durability of both ends; `rigel status` checks discovery"
        yield Problem(path, message, "unmatched", "warning", remedy=remedy, subjects=(name,))
    yield from topic.losses
    if topic.subscribers and not topic.publishers and topic.name not in OPTIONAL_TOPICS:
        some = ", ".join(topic.subscribers[:3]) + (", ..." if len(topic.subscribers) > 3 else "")
        message = f"{topic.name} has no publisher; subscribed by {some}"
        alike = [one.name for one in published if not topic.type or one.type == topic.type]
        near = get_close_matches(topic.name, alike, n=1)
        remedy = f"is {near[0]} meant, which is published?" if near else ""
        subjects = topic.subscribers
        yield Problem(path, message, "no-publisher", "warning", remedy=remedy, subjects=subjects)
