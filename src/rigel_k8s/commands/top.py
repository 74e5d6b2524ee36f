"""top: what each ROS node uses, and what Prometheus knows of it; and the topics between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import attrs

from rigel_k8s.commands.pods import Pod, choose_pods
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.commands.top_usage import Usage, measure_usage
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.observability.names import PROMETHEUS
from rigel_k8s.observability.reading.prometheus import PrometheusClient, Sample, matchers
from rigel_k8s.observability.reading.stack import NoStack, part_of
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings

#: A mean of this time is told, of a series that is as old; two scrapes are in it in any case.
SPAN = "2m"


def growth_rate(series: str) -> str:
    """Return a counter's growth a second; of a young one that between its last two scrapes."""
    return f"(rate({series}[{SPAN}]) and {series} offset {SPAN} or irate({series}[5m]))"


UP = "max by (ros_node, workload) (ros_node_up{{{0}}})"
FLOW = f"sum by (ros_node, direction) ({growth_rate('ros_node_topic_messages_total{{{0}}}')})"
#: By topic; the nodes' own counts stand in for topics that the exporter was not told to hear.
SENT = '{{{0},direction="published"}}'
TOPICS = {
    "publishers": "max by (topic, type) (ros_topic_publishers{{{0}}})",
    "subscribers": "max by (topic, type) (ros_topic_subscribers{{{0}}})",
    "heard": f"sum by (topic) ({growth_rate('ros_topic_messages_total{{{0}}}')})",
    "heard_bytes": f"sum by (topic) ({growth_rate('ros_topic_bytes_total{{{0}}}')})",
    "counted": f"sum by (topic) ({growth_rate('ros_node_topic_messages_total' + SENT)})",
    "counted_bytes": f"sum by (topic) ({growth_rate('ros_node_topic_bytes_total' + SENT)})",
    # When it was scraped: since then it has only become older for us.
    "age": "min by (topic) (timestamp(ros_topic_last_message_timestamp_seconds{{{0}}})"
    " - ros_topic_last_message_timestamp_seconds{{{0}}})",
    "delay": "max by (topic) (ros_topic_header_age_seconds{{{0}}})",
}


@attrs.frozen
class UsageRow:
    """A pod of a ROS node; what nobody told is None.

    Attributes:
        cpu: cores.
        memory: bytes.
        up: whether the ROS node is in the graph and answers.
        published, received: messages a second, of all its topics, as the node itself counts them.
    """

    workload: str
    ros_name: str
    pod: str
    node: str
    restarts: int
    cpu: float | None
    memory: float | None
    up: bool | None
    published: float | None
    received: float | None


@attrs.frozen
class Top:
    """Rows, and who told them: prometheus, metrics-server or kubelet; and why not one before."""

    release: ReleaseId
    rows: tuple[UsageRow, ...]
    source: str
    reasons: tuple[str, ...]


@attrs.frozen
class TopicUsage:
    """A topic; what nobody told is None.

    Attributes:
        rate: messages a second.
        bandwidth: bytes a second; of a topic that is not heard what its publishers sent in all.
        age: seconds since the last message when it was scraped last, of a topic that is heard.
        delay: seconds from a message's stamp to its being heard.
        heard: whether the exporter subscribes to it.
    """

    name: str
    type: str
    publishers: int
    subscribers: int
    rate: float | None
    bandwidth: float | None
    age: float | None
    delay: float | None
    heard: bool


@attrs.frozen
class Topics:
    """The topics of a release."""

    release: ReleaseId
    rows: tuple[TopicUsage, ...]


def top(settings: Settings, nodes: Sequence[str], job: str | None = None) -> Top:
    """Return what the pods of some ROS nodes use, or of all.

    Raises:
        UserError: there is no such node, or no pod at all.
        ClusterError: nobody tells what they use.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        pods = choose_running_pods(found, nodes)
        try:
            prometheus: PrometheusClient | NoStack | ClusterError = prometheus_of(found)
        except (NoStack, ClusterError) as error:
            prometheus = error
        usage = measure_usage(cluster, pods, prometheus)
        told = ros_of(found, prometheus) if isinstance(prometheus, PrometheusClient) else Ros()
    rows = tuple(row_of(pod, usage.by_pod.get(pod.name), told) for pod in pods)
    return Top(found.id, rows, usage.source, usage.reasons)


def topics(settings: Settings, nodes: Sequence[str], job: str | None = None) -> Topics:
    """Return the topics of a release, as its ROS exporter sees them.

    Raises:
        UserError: names of nodes are given; there is no stack; no exporter looks at the release.
        ClusterError: Prometheus may not be asked.
    """
    if nodes:
        raise UserError("--topics shows the topics of all nodes", hint="leave the names out")
    found = release(settings, job)
    with found.cluster as cluster:
        prometheus = prometheus_of(found)
        own = select_series(found.id)
        queries = [text.format(own) for text in TOPICS.values()]
        answers = dict(zip(TOPICS, cluster.parallel(prometheus.query, queries), strict=True))
    rows = topics_of(answers)
    if not rows:
        raise UserError(
            f"Prometheus knows no topic of {found.id.name} in {found.id.namespace}",
            hint="`observability: {enabled: true}` in its job deploys an exporter beside its nodes,"
            " whose first look comes within a minute",
        )
    return Topics(found.id, rows)


def choose_running_pods(found: Release, nodes: Sequence[str]) -> list[Pod]:
    """Return the pods that run; raises where there is none."""
    pods = choose_pods(found, nodes)
    return [pod for pod in pods if pod.phase == "Running"] or pods


def prometheus_of(found: Release) -> PrometheusClient:
    """Return the stack's Prometheus; raises as part_of."""
    return PrometheusClient(part_of(found.cluster, PROMETHEUS, found.observability).ask)


def select_series(release: ReleaseId) -> str:
    """Return the matchers of a release's series."""
    return matchers(application=release.name, namespace=release.namespace)


@attrs.frozen
class Ros:
    """What the exporter tells of nodes, by ROS name; of pods of several (a launch) by workload."""

    up: dict[str, float] = attrs.field(factory=dict)
    published: dict[str, float] = attrs.field(factory=dict)
    received: dict[str, float] = attrs.field(factory=dict)


def ros_of(found: Release, prometheus: PrometheusClient) -> Ros:
    """Return what Prometheus knows of a release's ROS nodes; nothing where it has no exporter."""
    own = select_series(found.id)
    queries = [UP.format(own), FLOW.format(own)]
    try:
        up, flow = found.cluster.parallel(prometheus.query, queries)
    except ClusterError:
        return Ros()

    def flows(direction: str) -> dict[str, float]:
        return index_by(
            "ros_node", (sample for sample in flow if sample.labels.get("direction") == direction)
        )

    # Several nodes of one workload: the one that is not there counts.
    whole = index_by("workload", sorted(up, key=lambda sample: -sample.value))
    return Ros({**whole, **index_by("ros_node", up)}, flows("published"), flows("received"))


def index_by(label: str, samples: Iterable[Sample]) -> dict[str, float]:
    """Return the values of series by one of their labels."""
    return {sample.labels.get(label, ""): sample.value for sample in samples}


def row_of(pod: Pod, usage: Usage | None, told: Ros) -> UsageRow:
    """Return a pod's row."""
    name = pod.ros_name
    up = told.up.get(name or pod.workload)
    return UsageRow(
        workload=pod.workload,
        ros_name=name,
        pod=pod.name,
        node=pod.machine,
        restarts=pod.restarts,
        cpu=usage.cpu if usage else None,
        memory=usage.memory if usage else None,
        up=None if up is None else bool(up),
        published=told.published.get(name),
        received=told.received.get(name),
    )


def topics_of(answers: Mapping[str, Sequence[Sample]]) -> tuple[TopicUsage, ...]:
    """Return the topics that the answers to TOPICS tell of, by name."""
    told = {name: index_by("topic", samples) for name, samples in answers.items()}
    types = {
        sample.labels.get("topic", ""): sample.labels.get("type", "")
        for sample in (*answers["publishers"], *answers["subscribers"])
    }
    found = []
    for name, kind in sorted(types.items()):
        heard = name in told["age"] or name in told["heard"]
        rates, sizes = ("heard", "heard_bytes") if heard else ("counted", "counted_bytes")
        found.append(
            TopicUsage(
                name=name,
                type=kind,
                publishers=int(told["publishers"].get(name, 0)),
                subscribers=int(told["subscribers"].get(name, 0)),
                rate=told[rates].get(name),
                bandwidth=told[sizes].get(name),
                age=told["age"].get(name),
                delay=told["delay"].get(name),
                heard=heard,
            )
        )
    return tuple(found)
