"""Labels of the contract (names.LABELS) from a pod's metadata, and files/relabelling.yaml.

Promtail, Alloy, Prometheus and prometheus-operator all take them in this form.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.observability.manifests.frame import load

Rule = dict[str, Any]

#: Label to where it is read from.
SOURCES: Mapping[str, str] = {
    "application": "__meta_kubernetes_pod_label_rigel_k8s_release",
    "workload": "__meta_kubernetes_pod_label_app_kubernetes_io_name",
    "ros_node": "__meta_kubernetes_pod_annotation_rigel_k8s_ros_name",
    "namespace": "__meta_kubernetes_namespace",
    "pod": "__meta_kubernetes_pod_name",
    "container": "__meta_kubernetes_pod_container_name",
    "node": "__meta_kubernetes_pod_node_name",
}


def contract() -> list[Rule]:
    """Return the rules that make a pod's labels."""
    return [{"source_labels": [source], "target_label": name} for name, source in SOURCES.items()]


def rules(name: str) -> list[Rule]:
    """Return a list of files/relabelling.yaml, of the caller's own."""
    found: list[Rule] = load("relabelling.yaml")[name]
    return found
