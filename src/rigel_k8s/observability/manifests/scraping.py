"""What Prometheus scrapes: prometheus.yml with the jobs of the contract."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import NAME_LABEL
from rigel_k8s.observability.manifests.frame import Object
from rigel_k8s.observability.manifests.relabelling import SOURCES, contract, keep_annotated
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import LOKI, PROMETHEUS, RELEASE

KUBE_STATE_METRICS = "kube-state-metrics"
NODE_EXPORTER = "node-exporter"
INTERVAL = "15s"
TOKEN = "/var/run/secrets/kubernetes.io/serviceaccount/token"
#: One pod must not fill Prometheus; the ROS exporter's own limits are far below these.
LIMITS = {"sample_limit": 20_000, "label_value_length_limit": 1024, "body_size_limit": "16MB"}
#: Metrics of cAdvisor that are kept: those of containers, pods' networks, and whole machines.
SLICES = {
    "source_labels": ["__name__", "id", "container", "pod"],
    "regex": r"(container_network_.+;.*;.*;.+|.+;/;.*;.*|.+;.*;.+;.*|machine_.+;.*;.*;.*)",
    "action": "keep",
}
#: Metrics that no dashboard or rule uses: most of the series.
UNASKED = {
    "source_labels": ["__name__"],
    "regex": "container_(tasks_state|memory_failures_total|blkio_device_usage_total|"
    "ulimits_soft|sockets|file_descriptors|threads_max|processes)",
    "action": "drop",
}
VOLUMES = {
    "source_labels": ["__name__"],
    "regex": "kubelet_volume_stats_.+",
    "action": "keep",
}
NODE_NAME = {"source_labels": ["__meta_kubernetes_node_name"], "target_label": "node"}


def configuration(stack: Stack, rules: str) -> str:
    """Return prometheus.yml.

    Args:
        rules: the directory with rule files.
    """
    options = stack.options.prometheus
    made: Object = {
        "global": {
            "scrape_interval": str(options.scrape_interval or INTERVAL),
            "evaluation_interval": str(options.evaluation_interval or INTERVAL),
        },
        "rule_files": [f"{rules}/*.yaml"],
        "scrape_configs": list(_jobs(stack)),
    }
    if options.alertmanagers:
        made["alerting"] = {
            "alertmanagers": [{"static_configs": [{"targets": list(options.alertmanagers)}]}]
        }
    return yaml.safe_dump(made, sort_keys=False, width=100_000)


def _jobs(stack: Stack) -> Iterator[Object]:
    yield _scrape_own(PROMETHEUS, stack)
    if stack.has_loki:
        yield _scrape_own(LOKI, stack)
    if stack.collector:
        yield _scrape_own(stack.collector, stack)
    if stack.kube_state_metrics.enabled:
        yield {**_scrape_own(KUBE_STATE_METRICS, stack), "honor_labels": True}
    if stack.node_exporter.enabled:
        yield _scrape_own(NODE_EXPORTER, stack)
    yield _kubelet("cadvisor", "/metrics/cadvisor", [SLICES, UNASKED])
    yield _kubelet("kubelet", "/metrics", [VOLUMES])
    yield {
        "job_name": "pods",
        # The exporter's metrics have the labels of nodes; its own pod's must not replace them.
        "honor_labels": True,
        **LIMITS,
        "kubernetes_sd_configs": [{"role": "pod"}],
        "relabel_configs": [*keep_annotated(), *contract()],
    }


def _scrape_own(part: str, stack: Stack) -> Object:
    """Return the job of one of the stack's own parts."""
    selector = f"{NAME_LABEL}={part},{RELEASE_LABEL}={RELEASE}"
    return {
        "job_name": part,
        "kubernetes_sd_configs": [
            {
                "role": "pod",
                "namespaces": {"names": [stack.namespace]},
                "selectors": [{"role": "pod", "label": selector}],
            }
        ],
        "relabel_configs": [
            {
                "source_labels": ["__meta_kubernetes_pod_container_port_name"],
                "action": "keep",
                "regex": "http",
            },
            *_labels(part),
        ],
    }


def _labels(part: str) -> list[Object]:
    """Return the labels of a part's own metrics; metrics about others only get its place."""
    if part == KUBE_STATE_METRICS:
        return []
    if part == NODE_EXPORTER:
        return [{"source_labels": [SOURCES["node"]], "target_label": "node"}]
    return contract()


def _kubelet(job: str, path: str, kept: list[Object]) -> Object:
    """Return a job for all kubelets, whose certificates are self-signed."""
    return {
        "job_name": job,
        "scheme": "https",
        "metrics_path": path,
        "authorization": {"credentials_file": TOKEN},
        "tls_config": {"insecure_skip_verify": True},
        "kubernetes_sd_configs": [{"role": "node"}],
        "relabel_configs": [NODE_NAME],
        "metric_relabel_configs": kept,
    }
