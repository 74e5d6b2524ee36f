"""PodMonitors and rules for an existing prometheus-operator, instead of our Prometheus."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import yaml

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import NAME_LABEL
from rigel_k8s.observability.manifests.frame import Object
from rigel_k8s.observability.manifests.relabelling import SOURCES, contract, keep_annotated
from rigel_k8s.observability.manifests.scraping import KUBE_STATE_METRICS, NODE_EXPORTER
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.observability.options import ExistingPrometheus

GROUP_VERSION = "monitoring.coreos.com/v1"
#: The kinds that the operator installs.
KINDS = ("PodMonitor", "PrometheusRule")
#: Fields of Prometheus' configuration, by their names in the operator's objects.
FIELDS = {
    "source_labels": "sourceLabels",
    "target_label": "targetLabel",
    "separator": "separator",
    "regex": "regex",
    "replacement": "replacement",
    "action": "action",
}


def monitoring(stack: Stack, found: ExistingPrometheus) -> Iterator[Object]:
    """Yield the monitors of all applications and of the parts that are ours, and the rules."""
    yield _monitor(
        stack,
        found,
        "rigel-applications",
        {"matchExpressions": [{"key": RELEASE_LABEL, "operator": "Exists"}]},
        [*keep_annotated(), *contract(), job("pods")],
        everywhere=True,
    )
    for name, kept in _parts(stack):
        selector = {"matchLabels": {NAME_LABEL: name, RELEASE_LABEL: RELEASE}}
        rules = [
            {
                "source_labels": ["__meta_kubernetes_pod_container_port_name"],
                "action": "keep",
                "regex": "http",
            },
            *kept,
            job(name),
        ]
        yield _monitor(stack, found, name, selector, rules)
    groups = [group for text in stack.boards.rules.values() for group in _groups(text)]
    if groups:
        yield _object(stack, found, "PrometheusRule", RELEASE, {"groups": groups})


def job(name: str) -> Object:
    """Return the rule that gives targets the job of the contract."""
    return {"target_label": "job", "replacement": name}


def _parts(stack: Stack) -> Iterator[tuple[str, list[Object]]]:
    """Yield the parts of the stack to scrape, with their labels."""
    if stack.collector:
        yield stack.collector, contract()
    if stack.has_loki:
        yield "loki", contract()
    if stack.kube_state_metrics.enabled:
        yield KUBE_STATE_METRICS, []
    if stack.node_exporter.enabled:
        yield NODE_EXPORTER, [{"source_labels": [SOURCES["node"]], "target_label": "node"}]


def _groups(text: str) -> Sequence[Any]:
    return list((yaml.safe_load(text) or {}).get("groups") or [])


def _monitor(
    stack: Stack,
    found: ExistingPrometheus,
    name: str,
    selector: Object,
    rules: Sequence[Object],
    *,
    everywhere: bool = False,
) -> Object:
    endpoint = {
        "honorLabels": name in ("rigel-applications", KUBE_STATE_METRICS),
        "relabelings": [_rule(one) for one in rules],
    }
    spec: Object = {"selector": selector, "podMetricsEndpoints": [endpoint]}
    if everywhere:
        spec["namespaceSelector"] = {"any": True}
    return _object(stack, found, "PodMonitor", name, spec)


def _rule(one: Object) -> Object:
    return {FIELDS[key]: value for key, value in one.items()}


def _object(stack: Stack, found: ExistingPrometheus, kind: str, name: str, spec: Object) -> Object:
    metadata = stack.frame.metadata(name)
    metadata["labels"] |= {str(key): str(value) for key, value in found.labels.items()}
    return {"apiVersion": GROUP_VERSION, "kind": kind, "metadata": metadata, "spec": spec}
