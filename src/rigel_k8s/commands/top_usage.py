"""CPU and memory of pods: from metrics.k8s.io, or else from the machines' kubelets."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.commands.pods import Pod
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import Cluster, ObjectRef
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.quantities import parse_quantity
from rigel_k8s.observability.reading.stack import explain

METRICS = "metrics.k8s.io/v1beta1"


@attrs.frozen
class Usage:
    """What a pod uses now: cores, and bytes that the kernel would not give back."""

    cpu: float
    memory: float


@attrs.frozen
class Used:
    """What pods use, and its source: metrics-server or kubelet."""

    by_pod: Mapping[str, Usage]
    source: str


def measure_usage(cluster: Cluster, pods: Sequence[Pod]) -> Used:
    """Return what pods of one namespace use.

    Raises:
        ClusterError: neither source has it; with both reasons.
    """
    ways: dict[str, tuple[str, Callable[[], Mapping[str, Usage]]]] = {
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
        except ClusterError as error:
            forbidden = isinstance(error, Forbidden)
            reasons.append(f"you may not ask {name}" if forbidden else explain(name, error))
            continue
        if any(pod.name in found for pod in pods):
            return Used(found, source)
        reasons.append(f"{name} has none of these pods")
    raise ClusterError(
        "no source has the usage of these pods",
        details=reasons,
        hint="install a metrics-server, or request the right nodes/proxy",
    )


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
