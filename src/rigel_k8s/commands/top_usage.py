"""CPU and memory of pods: from Prometheus, from metrics.k8s.io, or from the machines' kubelets.

The later ones have only current values, and fewer; without the right to one, the next is used.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.commands.pods import Pod
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import Cluster, ObjectRef
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.quantities import parse_quantity
from rigel_k8s.observability.reading.prometheus import PrometheusClient, Sample, matchers
from rigel_k8s.observability.reading.stack import NoStack, explain

METRICS = "metrics.k8s.io/v1beta1"
#: The last two samples of each container, independent of the scrape interval.
CPU = (
    "sum by (pod) (max by (pod, container)"
    ' (irate(container_cpu_usage_seconds_total{{{0},container!="",container!="POD"}}[5m])))'
)
MEMORY = (
    "sum by (pod) (max by (pod, container)"
    ' (container_memory_working_set_bytes{{{0},container!="",container!="POD"}}))'
)


@attrs.frozen
class Usage:
    """What a pod uses now: cores, and bytes that the kernel would not give back."""

    cpu: float
    memory: float


@attrs.frozen
class Used:
    """What pods use.

    Attributes:
        source: prometheus, metrics-server or kubelet.
        reasons: why earlier sources were not used.
    """

    by_pod: Mapping[str, Usage]
    source: str
    reasons: tuple[str, ...]


def measure_usage(
    cluster: Cluster, pods: Sequence[Pod], prometheus: PrometheusClient | NoStack | ClusterError
) -> Used:
    """Return what pods of one namespace use, from the first source that has it.

    Raises:
        ClusterError: no source has it; with all reasons.
    """

    def try_prometheus() -> Mapping[str, Usage]:
        if not isinstance(prometheus, PrometheusClient):
            raise prometheus
        return ask_prometheus(cluster, prometheus, pods[0].namespace)

    ways: dict[str, tuple[str, Callable[[], Mapping[str, Usage]]]] = {
        "prometheus": ("Prometheus", try_prometheus),
        "metrics-server": (
            "metrics.k8s.io",
            lambda: ask_metrics_server(cluster, pods[0].namespace),
        ),
        "kubelet": ("the kubelets", lambda: ask_kubelets(cluster, pods)),
    }
    reasons: list[str] = []
    for source, (name, ask) in ways.items():
        try:
            found = ask()
        except (NoStack, ClusterError) as error:
            reasons.append(explain_refusal(name, error))
            continue
        if any(pod.name in found for pod in pods):
            return Used(found, source, tuple(reasons))
        reasons.append(f"{name} has none of these pods")
    raise ClusterError(
        "no source has the usage of these pods",
        details=reasons,
        hint="set `observability: {enabled: true}`, install a metrics-server, or request the"
        " right nodes/proxy",
    )


def explain_refusal(name: str, error: NoStack | ClusterError) -> str:
    """Return why a source was not used."""
    if isinstance(error, Forbidden) and name != "Prometheus":
        return f"you may not ask {name}"
    return explain(name, error)


def ask_prometheus(
    cluster: Cluster, prometheus: PrometheusClient, namespace: str
) -> Mapping[str, Usage]:
    """Return what Prometheus has from the kubelets' cAdvisors."""
    own = matchers(namespace=namespace)
    queries = [CPU.format(own), MEMORY.format(own)]
    cpu, memory = (index_by_pod(found) for found in cluster.parallel(prometheus.query, queries))
    return {pod: Usage(cpu[pod], memory[pod]) for pod in cpu if pod in memory}


def index_by_pod(samples: Iterable[Sample]) -> dict[str, float]:
    """Return the values by pod."""
    return {sample.labels.get("pod", ""): sample.value for sample in samples}


def ask_metrics_server(cluster: Cluster, namespace: str) -> Mapping[str, Usage]:
    """Return what metrics.k8s.io (the metrics-server) has."""
    if not cluster.serves(METRICS, "PodMetrics"):
        raise ClusterError("the cluster has no metrics-server")
    return {
        item["metadata"]["name"]: Usage(
            sum(float(parse_quantity(c["usage"]["cpu"])) for c in item["containers"]),
            sum(float(parse_quantity(c["usage"]["memory"])) for c in item["containers"]),
        )
        for item in cluster.list(METRICS, "PodMetrics", namespace)
    }


def ask_kubelets(cluster: Cluster, pods: Sequence[Pod]) -> Mapping[str, Usage]:
    """Return the usage from the kubelets of the pods' machines."""
    machines = sorted({pod.machine for pod in pods} - {""})

    def ask(machine: str) -> Any:
        node = ObjectRef("v1", "Node", "", machine)
        return json.loads(
            cluster.get_through_proxy(node, "stats/summary", query={"only_cpu_and_memory": "true"})
        )

    return {
        name: usage
        for summary in cluster.parallel(ask, machines)
        for name, usage in read_summary(summary, pods[0].namespace).items()
    }


def read_summary(summary: Mapping[str, Any], namespace: str) -> dict[str, Usage]:
    """Return the pods of a namespace in a kubelet's summary, without those that just started."""
    found = {}
    for pod in summary.get("pods") or []:
        containers = pod.get("containers") or []
        cpu = [c.get("cpu", {}).get("usageNanoCores") for c in containers]
        memory = [c.get("memory", {}).get("workingSetBytes") for c in containers]
        if pod["podRef"]["namespace"] == namespace and containers and None not in (*cpu, *memory):
            found[pod["podRef"]["name"]] = Usage(sum(cpu) / 1e9, float(sum(memory)))
    return found
