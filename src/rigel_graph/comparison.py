"""Whether an update has made a ROS graph worse: `compare`; pure.

Why: after an update all pods may be ready while a topic has lost its publisher. Only what the
release runs counts: people start and stop tools, and nodes on their laptops, at any time. A name
that a node makes at start is compared without the part that differs from start to start.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import attrs

from rigel_graph.problems import find_problems, topic_of
from rigel_graph.types import FEEDBACK, GraphNode, GraphTopic, RosGraph
from rigel_k8s.objects.text import plural
from rigel_k8s.problems import Problem

#: What rospy (PID and milliseconds), roscpp (nanoseconds) and tf2 (an address) add to a name.
GENERATED = re.compile(r"(_\d+_\d{10,}|_(?=[a-f]*\d)[0-9a-f]{8,})(?=/|$)")
#: Nodes that start and end without being in the Rigelfile: hidden ones, the exporter, that of
#: `ros2 launch`, and tools by the names that they make at start (a deployed one has its own). The
#: bridge subscribes to what its viewers show.
TOOLS = re.compile(
    r"/(.*/)?(_[^/]*|ros_exporter\w*|foxglove(_bridge)?|launch_ros_\d+"
    r"|(ros(topic|service|node|param|launch|bag)|record|play|rviz|rqt\w*)"
    r"_(\d{3,}|\d+_\d{10,})(_\d+)*)"
)
#: Messages per second below which a rate is too uncertain to compare, and the part that must stay.
SLOWEST, PART = 1.0, 0.5


@attrs.frozen
class Comparison:
    """The effect of an update on a graph, in lines for people.

    Attributes:
        worse: what is missing, or no longer works.
        changed: other differences, on purpose or harmless.
    """

    worse: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()


@attrs.frozen
class _Side:
    """One of the two graphs, with nodes, topics and services by their comparable names.

    Attributes:
        names: the comparable name of each node that counts, by its own name.
        topics: by comparable name; several topics that differ only in generated parts are one.
    """

    graph: RosGraph
    names: Mapping[str, str]
    topics: Mapping[str, GraphTopic]

    @property
    def nodes(self) -> Counter[str]:
        return Counter(self.names.values())

    def count(self, owners: Iterable[str]) -> int:
        """Return how many of these nodes count."""
        return sum(1 for name in owners if name in self.names)


def compare(
    before: RosGraph,
    after: RosGraph,
    *,
    removed: Collection[str] = (),
    broken: Mapping[str, Sequence[str]] | None = None,
) -> Comparison:
    """Return what has become worse in a graph, and what has only changed.

    Args:
        removed: names of nodes of `before` that the update removes on purpose.
        broken: lines about topics that are no longer as they are expected to be, by their names.
    """
    broken = broken or {}
    old = make_side(before, {n.name for n in before.nodes if is_own(n)} - {*removed})
    known = set(old.names.values())
    new = make_side(after, {n.name for n in after.nodes if is_own(n) or name_of(n) in known})
    fresh = list_new_problems(old, new, removed)
    errors = [problem for problem in fresh if problem.is_error]
    topics = list(compare_topics(old, new))
    named = {name for problem in errors for name in problem.subjects}
    lost = {topic for topic, _ in topics}
    return Comparison(
        worse=(
            *list_lost_nodes(old, new, {generalise(name) for name in named}),
            *(problem.message for problem in errors),
            *(line for _, line in topics),
            *compare_services(old, new),
            *compare_rates(old, new, lost | {*map(generalise, broken)}, removed),
            *(line for name in broken if generalise(name) not in lost for line in broken[name]),
        ),
        changed=(
            *list_changes(old, new, removed),
            *(p.message for p in fresh if not p.is_error and generalise(topic_of(p)) not in lost),
        ),
    )


def make_side(graph: RosGraph, counted: Collection[str]) -> _Side:
    """Return a graph as it is compared; a node that does not answer does not count."""
    names = {n.name: name_of(n) for n in graph.nodes if n.name in counted and n.up}
    topics: dict[str, GraphTopic] = {}
    for topic in graph.topics:
        if not topic.is_public:
            continue
        name = generalise(topic.name)
        same = topics.get(name, attrs.evolve(topic, publishers=(), subscribers=()))
        topics[name] = attrs.evolve(
            same,
            rate=None if name in topics else topic.rate,
            publishers=(*same.publishers, *topic.publishers),
            subscribers=(*same.subscribers, *topic.subscribers),
        )
    return _Side(graph, names, topics)


def is_own(node: GraphNode) -> bool:
    """Whether a node is of the release: in one of its pods, or at an address that some share."""
    return bool(node.workload or node.machine) and not is_tool(node.name)


def is_tool(name: str) -> bool:
    """Whether a node of this name is not part of a release's purpose."""
    return TOOLS.fullmatch(name) is not None


def name_of(node: GraphNode) -> str:
    """Return the name to compare a node by; a launch file's `anon` puts the pod's name into it."""
    pod = "_" + re.sub(r"\W", "_", node.pod)
    return generalise(node.name).replace(pod, "") if node.pod else generalise(node.name)


def generalise(name: str) -> str:
    """Return a ROS name without the parts that are made at start."""
    return GENERATED.sub("", name)


def list_lost_nodes(old: _Side, new: _Side, named: Collection[str]) -> Iterator[str]:
    """Yield the missing nodes, except those that a problem names."""
    now = new.nodes
    for name, had in sorted(old.nodes.items()):
        if now[name] >= had or name in named:
            continue
        if had == 1:
            yield f"{name} is no longer in the graph"
        else:
            yield f"{name}: there were {had} nodes of this name, now {now[name]}"


def list_new_problems(old: _Side, new: _Side, removed: Collection[str]) -> list[Problem]:
    """Return the problems that the graph did not have before.

    If a node outside of the release no longer answers, the update is not the cause; if types no
    longer fit, it is.
    """
    own = {node.name for node in new.graph.nodes if is_own(node)} | set(new.names)
    known = {identify(problem) for problem in find_problems(old.graph)}
    return [
        problem
        for problem in find_problems(new.graph)
        if identify(problem) not in known
        and (problem.kind == "type" or any(name in own for name in problem.subjects))
        and not all(name in removed or is_tool(name) for name in problem.subjects)
    ]


def identify(problem: Problem) -> tuple[object, ...]:
    """Return what makes two problems the same; a missing publisher is the topic's, not a node's."""
    nodes = () if problem.kind == "no-publisher" else tuple(map(generalise, problem.subjects))
    return problem.kind, generalise(topic_of(problem)), nodes


def compare_topics(old: _Side, new: _Side) -> Iterator[tuple[str, str]]:
    """Yield (topic, line) of topics with fewer publishers or subscribers than before.

    A subscriber that never heard a publisher is no loss: an update may correct a topic's name.
    """
    for name, topic in old.topics.items():
        now = new.topics.get(name, GraphTopic(name))
        for what, a, b in (
            ("publisher", topic.publishers, now.publishers),
            ("subscriber", topic.subscribers, now.subscribers),
        ):
            had, has = old.count(a), new.count(b)
            if has < had and (has or topic.publishers):
                yield name, f"{show(name)} had {plural(had, what)}, now {has}"


def compare_services(old: _Side, new: _Side) -> Iterator[str]:
    """Yield services that no longer exist or have fewer providers than before."""
    before, now = count_providers(old), count_providers(new)
    for name, had in before.items():
        if had and not now[name]:
            yield f"the service {name} no longer exists"
        elif now[name] < had:
            yield f"the service {name} had {had} providers, now {now[name]}"


def count_providers(side: _Side) -> Counter[str]:
    """Return how many nodes provide each service; those that each node has are left out."""
    found: Counter[str] = Counter()
    for service in side.graph.services:
        if service.is_public:
            found[generalise(service.name)] += side.count(service.providers)
    return found


def compare_rates(
    old: _Side, new: _Side, lost: Collection[str], removed: Collection[str]
) -> Iterator[str]:
    """Yield topics whose rate fell, except those that have lost a publisher or a subscriber."""
    for name, topic in old.topics.items():
        now = new.topics.get(name)
        if now is None or topic.rate is None or now.rate is None or name in lost:
            continue
        fewer = any(publisher in removed for publisher in topic.publishers)
        if topic.rate >= SLOWEST and now.rate < topic.rate * PART and not fewer:
            yield f"{show(name)} had {topic.rate:.3g} messages/s, now {now.rate:.3g}"


def list_changes(old: _Side, new: _Side, removed: Collection[str]) -> Iterator[str]:
    """Yield harmless differences."""
    gone = {name_of(n) for n in old.graph.nodes if n.name in removed and n.registered}
    for name in sorted(gone - set(new.nodes)):
        yield f"{name} is removed"
    for name in sorted(set(new.nodes - old.nodes) - gone):
        yield f"{name} is new" if name not in old.nodes else f"{name}: one more node of this name"
    for name in sorted(set(new.topics) - set(old.topics)):
        if new.count((*new.topics[name].publishers, *new.topics[name].subscribers)):
            yield f"{show(name)} is a new topic"
    for name, topic in old.topics.items():
        now = new.topics.get(name, GraphTopic(name))
        if old.count(topic.subscribers) and not topic.publishers and not new.count(now.subscribers):
            yield f"{show(name)} has no subscriber now, it had no publisher"
        if topic.type and now.type not in ("", topic.type) and not now.mismatches:
            yield f"{show(name)} has the type {now.type} now, it was {topic.type}"


def show(topic: str) -> str:
    """Return the name of a topic in a line."""
    if topic.endswith(FEEDBACK):
        return f"the action {topic.removesuffix(FEEDBACK)}"
    return topic
