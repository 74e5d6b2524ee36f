"""Labels of the contract (names.LABELS) from a pod's metadata.

Promtail, Alloy, Prometheus and prometheus-operator all take them in this form.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import NAME_LABEL, ROS_NAME_ANNOTATION

Rule = dict[str, Any]


def meta(kind: str, key: str) -> str:
    """Return Prometheus' name of a pod's label or annotation."""
    plain = "".join(letter if letter.isalnum() else "_" for letter in key)
    return f"__meta_kubernetes_pod_{kind}_{plain}"


#: Label to where it is read from.
SOURCES: Mapping[str, str] = {
    "application": meta("label", RELEASE_LABEL),
    "workload": meta("label", NAME_LABEL),
    "ros_node": meta("annotation", ROS_NAME_ANNOTATION),
    "namespace": "__meta_kubernetes_namespace",
    "pod": "__meta_kubernetes_pod_name",
    "container": "__meta_kubernetes_pod_container_name",
    "node": "__meta_kubernetes_pod_node_name",
}


def select_releases() -> str:
    """Return the selector of pods that belong to a release."""
    return RELEASE_LABEL


def contract() -> list[Rule]:
    """Return the rules that make a pod's labels."""
    return [{"source_labels": [source], "target_label": name} for name, source in SOURCES.items()]


def log_path(directory: str) -> Iterator[Rule]:
    """Yield the rules for the path at which the kubelet keeps a container's lines."""
    container = "__meta_kubernetes_pod_container_name"
    yield {
        "source_labels": ["__meta_kubernetes_pod_uid", container],
        "separator": "/",
        "target_label": "__path__",
        "replacement": f"{directory}/*$1/*.log",
    }
    # The directories of static pods have the hash of their manifest in their names.
    yield {
        "source_labels": [meta("annotation", "kubernetes.io/config.hash"), container],
        "separator": "/",
        "regex": "(.+/.+)",
        "target_label": "__path__",
        "replacement": f"{directory}/*$1/*.log",
    }


def keep_annotated() -> list[Rule]:
    """Return the rules that keep pods with annotations for scraping, at the port that they name."""
    number, asked = "__meta_kubernetes_pod_container_port_number", name_annotation("port")
    return [
        {"source_labels": [name_annotation("scrape")], "action": "keep", "regex": "true"},
        {
            "source_labels": ["__meta_kubernetes_pod_phase"],
            "action": "drop",
            "regex": "Succeeded|Failed",
        },
        {
            "source_labels": ["__meta_kubernetes_pod_container_init"],
            "action": "drop",
            "regex": "true",
        },
        # Of several ports, only the requested one; a container may also declare none.
        {"source_labels": [number], "target_label": "__tmp_port"},
        {
            "source_labels": [number, asked],
            "regex": ";(.+)",
            "target_label": "__tmp_port",
        },
        {"source_labels": ["__tmp_port"], "target_label": "__tmp_wanted"},
        {"source_labels": [asked], "regex": "(.+)", "target_label": "__tmp_wanted"},
        {"source_labels": ["__tmp_port"], "action": "keepequal", "target_label": "__tmp_wanted"},
        {
            "source_labels": ["__meta_kubernetes_pod_ip", "__tmp_wanted"],
            "separator": ":",
            "regex": r"(\d+\.\d+\.\d+\.\d+:\d+)",
            "target_label": "__address__",
        },
        {
            "source_labels": ["__meta_kubernetes_pod_ip", "__tmp_wanted"],
            "regex": "(.*:.*);(.+)",
            "target_label": "__address__",
            "replacement": "[$1]:$2",
        },
        {
            "source_labels": [name_annotation("scheme")],
            "regex": "(https?)",
            "target_label": "__scheme__",
        },
        {
            "source_labels": [name_annotation("path")],
            "regex": "(.+)",
            "target_label": "__metrics_path__",
        },
    ]


def name_annotation(word: str) -> str:
    """Return Prometheus' name of an annotation by which pods request scraping."""
    return meta("annotation", f"prometheus.io/{word}")
