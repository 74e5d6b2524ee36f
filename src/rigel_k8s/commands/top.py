"""top: what each ROS node uses, its data in Prometheus, and the topics between nodes.

CPU and memory come from metrics.k8s.io (the metrics-server), or else from the machines' kubelets.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.commands.pods import Pod, choose_pods
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import Cluster, ObjectRef
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.resources import parse_quantity
from rigel_k8s.observability.names import PROMETHEUS
from rigel_k8s.observability.reading.prometheus import PrometheusClient, Sample, matchers
from rigel_k8s.observability.reading.stack import NoStack, choose_service, explain
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings

METRICS = "metrics.k8s.io/v1beta1"
#: The mean over this time, if the series is old enough; it always contains two scrapes.
SPAN = "2m"


#: When the exporter has looked at the graph: a scrape shows what the last look has found.
LOOKED = "ros_exporter_last_collect_timestamp_seconds{{{0}}}"


def growth_rate(series: str) -> str:
    """Return a counter's growth per second; of a young one between its last two scrapes."""
    return f"(rate({series}[{SPAN}]) and {series} offset {SPAN} or irate({series}[5m]))"


def count_rate(name: str) -> str:
    """Return how much a number that nodes count grows in a second between looks at the graph."""
    by_look = f"on (instance) group_left max by (instance) ({growth_rate(LOOKED)} > 0)"
    return f"{growth_rate(name)} / {by_look}"


#: What a node itself counts of its topics.
SENT = '{{{0},direction="published"}}'
RECEIVED = '{{{0},direction="received"}}'
#: By ROS name, one by workload; of a workload's nodes, one that is missing counts.
NODES = {
    "up": "max by (ros_node) (ros_node_up{{{0}}})",
    "all_up": "min by (workload) (max by (ros_node, workload) (ros_node_up{{{0}}}))",
    "published": f"sum by (ros_node) ({count_rate('ros_node_topic_messages_total' + SENT)})",
    "received": f"sum by (ros_node) ({count_rate('ros_node_topic_messages_total' + RECEIVED)})",
}
#: By topic; topics that the exporter does not subscribe to use the nodes' own counts.
TOPICS = {
    "publishers": "max by (topic, type) (ros_topic_publishers{{{0}}})",
    "subscribers": "max by (topic, type) (ros_topic_subscribers{{{0}}})",
    "heard": f"sum by (topic) ({growth_rate('ros_topic_messages_total{{{0}}}')})",
    "heard_bytes": f"sum by (topic) ({growth_rate('ros_topic_bytes_total{{{0}}}')})",
    "counted": f"sum by (topic) ({count_rate('ros_node_topic_messages_total' + SENT)})",
    "counted_bytes": f"sum by (topic) ({count_rate('ros_node_topic_bytes_total' + SENT)})",
    # At the time of the scrape.
    "age": "min by (topic) (timestamp(ros_topic_last_message_timestamp_seconds{{{0}}})"
    " - ros_topic_last_message_timestamp_seconds{{{0}}})",
    "delay": "max by (topic) (ros_topic_header_age_seconds{{{0}}})",
}


@attrs.frozen
class Usage:
    """What a pod uses now: cores, and bytes that the kernel would not give back."""

    cpu: float
    memory: float


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
    found = release(settings, job, nodes)
    with found.cluster as cluster:
        pods = choose_pods(found, nodes)
        pods = [pod for pod in pods if pod.phase == "Running"] or pods
        usage, source = measure_usage(cluster, pods)
        try:
            samples = ask_prometheus(found, NODES)
        except (NoStack, ClusterError):
            samples = {}
    return Top(found.id, tuple(make_rows(pods, usage, samples)), source)


def topics(settings: Settings, nodes: Sequence[str], job: str | None = None) -> Topics:
    """Return the topics of a release, as its ROS exporter sees them.

    Raises:
        UserError: names of nodes are given; there is no stack; the release has no exporter.
        ClusterError: access to Prometheus is denied.
    """
    if nodes:
        raise UserError("--topics shows the topics of all nodes", hint="remove the names")
    found = release(settings, job)
    with found.cluster:
        try:
            rows = topics_of(ask_prometheus(found, TOPICS))
        except NoStack as error:
            ways = ("`rigel graph` shows topics and rates without it", error.hint)
            error.hint = "; ".join(filter(None, ways))
            raise
    if not rows:
        raise UserError(
            f"Prometheus has no topics of {found.id.name} in {found.id.namespace}",
            hint="set `observability: {enabled: true}` in its job to deploy an exporter beside its"
            " nodes; its first data come within a minute",
        )
    return Topics(found.id, rows)


def ask_prometheus(found: Release, queries: Mapping[str, str]) -> dict[str, list[Sample]]:
    """Return what the stack's Prometheus has of a release, by the names of the queries.

    Raises:
        NoStack: no Prometheus is found.
        ClusterError: it does not answer, or access to it is denied.
    """
    client = PrometheusClient(choose_service(found.cluster, PROMETHEUS, found.observability).ask)
    own = matchers(application=found.id.name, namespace=found.id.namespace)
    texts = [query.format(own) for query in queries.values()]
    return dict(zip(queries, found.cluster.parallel(client.query, texts), strict=True))


def index_by(label: str, samples: Iterable[Sample]) -> dict[str, float]:
    """Return the values of series by one of their labels."""
    return {sample.labels.get(label, ""): sample.value for sample in samples}


def measure_usage(
    cluster: Cluster, pods: Sequence[Pod]
) -> tuple[Mapping[tuple[str, str], Usage], str]:
    """Return what pods of one namespace use, by names of pod and container, and its source.

    Raises:
        ClusterError: neither source has it; with both reasons.
    """
    reasons: list[str] = []
    for source, name, ask in (
        ("metrics-server", "metrics.k8s.io", ask_metrics_server),
        ("kubelet", "the kubelets", ask_kubelets),
    ):
        try:
            usage = ask(cluster, pods)
        except Forbidden:
            reasons.append(f"you may not ask {name}")
        except ClusterError as error:
            reasons.append(explain(name, error))
        else:
            if any(part_of_pod(pod) in usage for pod in pods):
                return usage, source
            reasons.append(f"{name} has none of these pods")
    raise ClusterError(
        "no source has the usage of these pods",
        details=reasons,
        hint="install a metrics-server, or request the right nodes/proxy",
    )


def part_of_pod(pod: Pod) -> tuple[str, str]:
    """Return what of a pod is a node's: all, or one container if there are other nodes in it."""
    return pod.name, pod.container if pod.shared else ""


def ask_metrics_server(cluster: Cluster, pods: Sequence[Pod]) -> Mapping[tuple[str, str], Usage]:
    """Return the usage of all pods of the namespace, and of each of their containers."""
    if not cluster.serves(METRICS, "PodMetrics"):
        raise ClusterError("the cluster has no metrics-server")
    return add_up(
        (
            item["metadata"]["name"],
            str(one["name"]),
            Usage(*(float(parse_quantity(one["usage"][what])) for what in ("cpu", "memory"))),
        )
        for item in cluster.list(METRICS, "PodMetrics", pods[0].namespace)
        for one in item["containers"]
    )


def add_up(parts: Iterable[tuple[str, str, Usage]]) -> dict[tuple[str, str], Usage]:
    """Return the usage of containers, and under "" that of their pods."""
    found: dict[tuple[str, str], Usage] = {}
    for pod, container, used in parts:
        found[pod, container] = used
        whole = found.get((pod, ""), Usage(0.0, 0.0))
        found[pod, ""] = Usage(whole.cpu + used.cpu, whole.memory + used.memory)
    return found


def ask_kubelets(cluster: Cluster, pods: Sequence[Pod]) -> Mapping[tuple[str, str], Usage]:
    """Return the usage of the namespace's pods on the machines of some pods."""

    def ask(machine: str) -> Any:
        node = ObjectRef("v1", "Node", "", machine)
        query = {"only_cpu_and_memory": "true"}
        return json.loads(cluster.get_through_proxy(node, "stats/summary", query=query))

    usage: dict[tuple[str, str], Usage] = {}
    for summary in cluster.parallel(ask, sorted({pod.machine for pod in pods} - {""})):
        usage |= read_summary(summary, pods[0].namespace)
    return usage


def read_summary(summary: Mapping[str, Any], namespace: str) -> dict[tuple[str, str], Usage]:
    """Return the pods of a namespace in a kubelet's summary, without those that just started."""
    found: dict[tuple[str, str], Usage] = {}
    for pod in summary.get("pods") or []:
        containers = pod.get("containers") or []
        cpu = [c.get("cpu", {}).get("usageNanoCores") for c in containers]
        memory = [c.get("memory", {}).get("workingSetBytes") for c in containers]
        if pod["podRef"]["namespace"] == namespace and containers and None not in (*cpu, *memory):
            name = pod["podRef"]["name"]
            used = [Usage(c / 1e9, float(m)) for c, m in zip(cpu, memory, strict=True)]
            found |= add_up((name, c["name"], u) for c, u in zip(containers, used, strict=True))
    return found


def make_rows(
    pods: Sequence[Pod],
    usage: Mapping[tuple[str, str], Usage],
    samples: Mapping[str, Sequence[Sample]],
) -> Iterator[UsageRow]:
    """Yield a row for each pod; `samples` are the answers to NODES, or empty."""
    up = {
        **index_by("workload", samples.get("all_up", ())),
        **index_by("ros_node", samples.get("up", ())),
    }
    published = index_by("ros_node", samples.get("published", ()))
    received = index_by("ros_node", samples.get("received", ()))
    for pod in pods:
        used = usage.get(part_of_pod(pod))
        is_up = up.get(pod.ros_name or pod.workload)
        yield UsageRow(
            workload=pod.workload,
            ros_name=pod.ros_name,
            pod=pod.name,
            node=pod.machine,
            restarts=pod.restarts,
            cpu=used.cpu if used else None,
            memory=used.memory if used else None,
            up=None if is_up is None else bool(is_up),
            published=published.get(pod.ros_name),
            received=received.get(pod.ros_name),
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
