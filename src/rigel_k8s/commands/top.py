"""top: what each ROS node uses, its data in Prometheus, and the topics between nodes."""

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

#: The mean over this time, if the series is old enough; it always contains two scrapes.
SPAN = "2m"


def growth_rate(series: str) -> str:
    """Return a counter's growth per second; of a young one between its last two scrapes."""
    return f"(rate({series}[{SPAN}]) and {series} offset {SPAN} or irate({series}[5m]))"


UP = "max by (ros_node, workload) (ros_node_up{{{0}}})"
FLOW = f"sum by (ros_node, direction) ({growth_rate('ros_node_topic_messages_total{{{0}}}')})"
#: By topic; topics that the exporter does not subscribe to use the nodes' own counts.
SENT = '{{{0},direction="published"}}'
TOPICS = {
    "publishers": "max by (topic, type) (ros_topic_publishers{{{0}}})",
    "subscribers": "max by (topic, type) (ros_topic_subscribers{{{0}}})",
    "heard": f"sum by (topic) ({growth_rate('ros_topic_messages_total{{{0}}}')})",
    "heard_bytes": f"sum by (topic) ({growth_rate('ros_topic_bytes_total{{{0}}}')})",
    "counted": f"sum by (topic) ({growth_rate('ros_node_topic_messages_total' + SENT)})",
    "counted_bytes": f"sum by (topic) ({growth_rate('ros_node_topic_bytes_total' + SENT)})",
    # At the time of the scrape.
    "age": "min by (topic) (timestamp(ros_topic_last_message_timestamp_seconds{{{0}}})"
    " - ros_topic_last_message_timestamp_seconds{{{0}}})",
    "delay": "max by (topic) (ros_topic_header_age_seconds{{{0}}})",
}


@attrs.frozen
class UsageRow:
    """A pod of a ROS node; unknown values are None.

    Attributes:
        cpu: cores.
        memory: bytes.
        up: whether the ROS node is in the graph and answers.
        published, received: messages per second, of all its topics, counted by the node itself.
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
    """Rows, and the source of CPU and memory: metrics-server or kubelet."""

    release: ReleaseId
    rows: tuple[UsageRow, ...]
    source: str


@attrs.frozen
class TopicUsage:
    """A topic; unknown values are None.

    Attributes:
        rate: messages per second.
        bandwidth: bytes per second; without a subscription what its publishers sent in total.
        age: seconds since the last message at the last scrape, with a subscription.
        delay: seconds from a message's stamp to its arrival at the exporter.
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
        UserError: the node is unknown, or there is no pod at all.
        ClusterError: no source has their usage.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        pods = choose_running_pods(found, nodes)
        usage = measure_usage(cluster, pods)
        try:
            ros = ros_of(found, prometheus_of(found))
        except (NoStack, ClusterError):
            ros = Ros()
    rows = tuple(row_of(pod, usage.by_pod.get(pod.name), ros) for pod in pods)
    return Top(found.id, rows, usage.source)


def topics(settings: Settings, nodes: Sequence[str], job: str | None = None) -> Topics:
    """Return the topics of a release, as its ROS exporter sees them.

    Raises:
        UserError: names of nodes are given; there is no stack; the release has no exporter.
        ClusterError: access to Prometheus is denied.
    """
    if nodes:
        raise UserError("--topics shows the topics of all nodes", hint="remove the names")
    found = release(settings, job)
    with found.cluster as cluster:
        prometheus = prometheus_of(found)
        own = select_series(found.id)
        queries = [text.format(own) for text in TOPICS.values()]
        answers = dict(zip(TOPICS, cluster.parallel(prometheus.query, queries), strict=True))
    rows = topics_of(answers)
    if not rows:
        raise UserError(
            f"Prometheus has no topics of {found.id.name} in {found.id.namespace}",
            hint="set `observability: {enabled: true}` in its job to deploy an exporter beside its"
            " nodes; its first data come within a minute",
        )
    return Topics(found.id, rows)


def choose_running_pods(found: Release, nodes: Sequence[str]) -> list[Pod]:
    """Return the running pods; raises if there are none."""
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
    """The exporter's data of nodes, by ROS name; of pods with several nodes by workload."""

    up: dict[str, float] = attrs.field(factory=dict)
    published: dict[str, float] = attrs.field(factory=dict)
    received: dict[str, float] = attrs.field(factory=dict)


def ros_of(found: Release, prometheus: PrometheusClient) -> Ros:
    """Return Prometheus' data of a release's ROS nodes; empty without an exporter.

    Raises:
        ClusterError: Prometheus does not answer.
    """
    own = select_series(found.id)
    up, flow = found.cluster.parallel(prometheus.query, [UP.format(own), FLOW.format(own)])

    def flows(direction: str) -> dict[str, float]:
        return index_by(
            "ros_node", (sample for sample in flow if sample.labels.get("direction") == direction)
        )

    # Of several nodes of one workload, a missing one counts.
    whole = index_by("workload", sorted(up, key=lambda sample: -sample.value))
    return Ros({**whole, **index_by("ros_node", up)}, flows("published"), flows("received"))


def index_by(label: str, samples: Iterable[Sample]) -> dict[str, float]:
    """Return the values of series by one of their labels."""
    return {sample.labels.get(label, ""): sample.value for sample in samples}


def row_of(pod: Pod, usage: Usage | None, ros: Ros) -> UsageRow:
    """Return a pod's row."""
    name = pod.ros_name
    up = ros.up.get(name or pod.workload)
    return UsageRow(
        workload=pod.workload,
        ros_name=name,
        pod=pod.name,
        node=pod.machine,
        restarts=pod.restarts,
        cpu=usage.cpu if usage else None,
        memory=usage.memory if usage else None,
        up=None if up is None else bool(up),
        published=ros.published.get(name),
        received=ros.received.get(name),
    )


def topics_of(answers: Mapping[str, Sequence[Sample]]) -> tuple[TopicUsage, ...]:
    """Return the topics in the answers to TOPICS, by name."""
    values = {name: index_by("topic", samples) for name, samples in answers.items()}
    types = {
        sample.labels.get("topic", ""): sample.labels.get("type", "")
        for sample in (*answers["publishers"], *answers["subscribers"])
    }
    found = []
    for name, kind in sorted(types.items()):
        heard = name in values["age"] or name in values["heard"]
        rates, sizes = ("heard", "heard_bytes") if heard else ("counted", "counted_bytes")
        found.append(
            TopicUsage(
                name=name,
                type=kind,
                publishers=int(values["publishers"].get(name, 0)),
                subscribers=int(values["subscribers"].get(name, 0)),
                rate=values[rates].get(name),
                bandwidth=values[sizes].get(name),
                age=values["age"].get(name),
                delay=values["delay"].get(name),
                heard=heard,
            )
        )
    return tuple(found)
