"""A ROS graph as plain values that can be compared; pure.

Why: the readers of a graph, its judge, its pictures and the comparison of two share nothing but
these classes, which are independent of where a graph comes from.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.problems import Problem

#: Seconds between two readings, of which rates are made.
SPAN = 2.0
#: Topics that each node has, and the log that a ROS 1 master's node collects.
OWN_TOPICS = frozenset({"/parameter_events", "/rosout", "/rosout_agg"})
#: The last part of services that each node has, for its parameters and its log, and of those whose
#: name differs in each pod of a lifecycle node that hands over.
OWN_SERVICES = frozenset(
    {
        *("change_state", "get_available_transitions"),
        *("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters"),
        *("set_parameters", "set_parameters_atomically", "get_type_description"),
        *("get_loggers", "set_logger_level", "get_logger_levels", "set_logger_levels"),
    }
)
#: The end of an action's name for one of its hidden topics, which stands for the action.
FEEDBACK = "/_action/feedback"


@attrs.frozen
class GraphNode:
    """A ROS node, or a node that the release expects and that is not in the graph.

    Attributes:
        name: the full ROS name; for a DDS program without ROS the name that it announces.
        machine: the Kubernetes node that it runs on, "" if that is unknown.
        pod, workload: of the release, "" for a node that no pod of it runs.
        address: where it is, for people.
        registered: it is in the ROS master, or in discovery.
        up: it is registered and answers.
        ready: its pod is ready; True for a node without a pod.
        stands: seconds for which its process has not looked for work, 0 while it waits for some.
    """

    name: str
    machine: str = attrs.field(default="", eq=False)
    pod: str = attrs.field(default="", eq=False)
    workload: str = ""
    address: str = attrs.field(default="", eq=False)
    registered: bool = True
    up: bool = True
    ready: bool = True
    stands: float = attrs.field(default=0.0, eq=False)


@attrs.frozen
class Mismatch:
    """An endpoint whose type is not that of its topic's other endpoints."""

    node: str
    type: str


@attrs.frozen
class GraphTopic:
    """A topic.

    Attributes:
        type: "" if it is unknown.
        publishers, subscribers: the names of nodes, sorted, each once.
        mismatches: endpoints that have another type than `type`.
        rate: messages per second, None if it is unknown.
        gap: the longest time between two messages of a publisher in the last minute, or since its
            last one, in seconds; None if it is unknown.
        age: how old the last message was when it was taken, in seconds, of the subscriber with the
            oldest; None if it is unknown.
        exists: seconds since its youngest publisher was made, None if that is unknown.
        alone: nodes whose endpoint has no partner, although the topic has others.
        losses: one for each subscriber that loses messages on the way.
        shared: (publisher, subscriber) of nodes whose messages go by shared memory.
    """

    name: str
    type: str = ""
    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()
    mismatches: tuple[Mismatch, ...] = ()
    rate: float | None = attrs.field(default=None, eq=False)
    gap: float | None = attrs.field(default=None, eq=False)
    age: float | None = attrs.field(default=None, eq=False)
    exists: float | None = attrs.field(default=None, eq=False)
    alone: tuple[str, ...] = attrs.field(default=(), eq=False)
    losses: tuple[Problem, ...] = attrs.field(default=(), eq=False)
    shared: tuple[tuple[str, str], ...] = attrs.field(default=(), eq=False)

    @property
    def is_public(self) -> bool:
        """Not one that each node has; of hidden topics only the one that stands for an action."""
        if self.name in OWN_TOPICS:
            return False
        return self.name.endswith(FEEDBACK) or "/_" not in self.name


@attrs.frozen
class GraphService:
    """A service; its type is "" if it is unknown (ROS 1's master does not have it)."""

    name: str
    type: str = ""
    providers: tuple[str, ...] = ()

    @property
    def is_public(self) -> bool:
        """Not one that each node has, and not a hidden one, such as those of an action."""
        return self.name.rpartition("/")[2] not in OWN_SERVICES and "/_" not in self.name


@attrs.frozen
class RosGraph:
    """The graph, each part sorted by name.

    Two graphs are equal if the same nodes have the same topics and services; machines, pods,
    addresses and rates, which differ after each restart, do not count.

    Attributes:
        leaving: the names of nodes whose pods are being terminated. What they publish may be in
            the graph until they have ended.
        span: seconds over which the rates were measured, 0 if they are exact or there are none.
        notes: POD/CONTAINER -> what the processes of ROS 2 noted, `first` and `second`.
    """

    nodes: tuple[GraphNode, ...] = ()
    topics: tuple[GraphTopic, ...] = ()
    services: tuple[GraphService, ...] = ()
    leaving: tuple[str, ...] = attrs.field(default=(), eq=False)
    span: float = attrs.field(default=0.0, eq=False)
    notes: Mapping[str, Mapping[str, Any]] = attrs.field(factory=dict, eq=False, repr=False)

    def with_rates(self, rates: Mapping[str, float]) -> RosGraph:
        """Return the graph with these rates, by topic, where it has none."""
        topics = (
            topic if topic.rate is not None else attrs.evolve(topic, rate=rates.get(topic.name))
            for topic in self.topics
        )
        return attrs.evolve(self, topics=tuple(topics))

    def without_rates(self) -> RosGraph:
        """Return the graph without rates, of a time that was too short for them."""
        topics = (attrs.evolve(topic, rate=None) for topic in self.topics)
        return attrs.evolve(self, topics=tuple(topics))


def compare_types(used: Sequence[tuple[str, str]]) -> tuple[str, tuple[Mismatch, ...]]:
    """Return the type that most nodes use (of equals the first), and the nodes with another one.

    Args:
        used: (node, type) of each endpoint, publishers first.
    """
    counts = Counter(kind for _, kind in used)
    kind = counts.most_common(1)[0][0] if counts else ""
    others = sorted({(node, other) for node, other in used if other != kind})
    return kind, tuple(Mismatch(node, other) for node, other in others)


@attrs.frozen
class WaitingNode:
    """A node that has started and waits for its name.

    Attributes:
        api: its URI.
        owner: the URI of the node that has the name, None if no node has it.
    """

    node: str
    api: str
    owner: str | None


@attrs.frozen
class NameConflict:
    """A node that lost its name to a younger one that does not replace it.

    Attributes:
        old: the URI of the node that lost it.
        new: the URI of the node that has it now.
        seconds: how long ago that was.
    """

    node: str
    old: str
    new: str
    seconds: float


@attrs.frozen
class GateStatus:
    """A gate.

    Attributes:
        conflicts: the last ones, oldest first; the gate forgets them when its pod is replaced.
        silent: nodes that have not answered since roscore came back.
        has_master: whether roscore answers it.
        restarts: how often this gate restored the registrations of a new roscore.
        blocked: why calls wait although roscore answers, "" if they do not.
        refused: the registrations and parameters that the last new roscore did not accept, and why.
        unkept: where the gate's state is not kept, and why.
        notes: what else is unusual, in words; an earlier gate has none.
        problem: why the gate did not answer; then nothing else is known.
    """

    waiting: tuple[WaitingNode, ...] = ()
    conflicts: tuple[NameConflict, ...] = ()
    silent: tuple[str, ...] = ()
    has_master: bool = True
    restarts: int = 0
    blocked: str = ""
    refused: tuple[str, ...] = ()
    unkept: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    problem: str = ""
