"""What Prometheus scrapes: prometheus.yml with the jobs of the contract.

Rules of relabelling make the labels of the contract (names.LABELS) from a pod's metadata; others
are in files/relabelling.yaml. Promtail and prometheus-operator take them in the same form.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import yaml

from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.pods import Object
from rigel_k8s.observability.names import LABELS, LOKI, PROMETHEUS, RELEASE
from rigel_k8s.observability.options import ExistingPrometheus
from rigel_stack.manifests.program import load
from rigel_stack.manifests.stack import Stack

KUBE_STATE_METRICS = "kube-state-metrics"
NODE_EXPORTER = "node-exporter"
INTERVAL = "15s"


def contract() -> list[Object]:
    """Return the rules that make a pod's labels."""
    return [{"source_labels": [source], "target_label": name} for name, source in LABELS.items()]


def rules(name: str) -> list[Object]:
    """Return a list of files/relabelling.yaml, of the caller's own."""
    found: list[Object] = load("relabelling.yaml")[name]
    return found


def write_prometheus_config(stack: Stack) -> str:
    options = stack.options.prometheus
    jobs = load("prometheus.yml")["scrape_configs"]
    for job in jobs:
        if job["job_name"] == "pods":
            job["relabel_configs"] = scrape_applications()
    made: Object = {
        "global": {
            "scrape_interval": str(options.scrape_interval or INTERVAL),
            "evaluation_interval": str(options.evaluation_interval or INTERVAL),
        },
        "rule_files": ["/etc/prometheus-rules/*.yaml"],
        "scrape_configs": [_scrape_own(*part, stack) for part in own_parts(stack)] + jobs,
    }
    if options.alertmanagers:
        targets = [str(target) for target in options.alertmanagers]
        made["alerting"] = {"alertmanagers": [{"static_configs": [{"targets": targets}]}]}
    return yaml.safe_dump(made, sort_keys=False, width=100_000)


def scrape_applications() -> list[Object]:
    """Return the rules for pods of applications."""
    return [*rules("annotated"), *contract()]


def own_parts(stack: Stack) -> Iterator[tuple[str, list[Object]]]:
    """Yield the stack's parts to scrape, with the rules for them.

    A part's own metrics have its labels; metrics about others only get its place.
    """
    if stack.has_prometheus:
        yield PROMETHEUS, [own_port(), *contract()]
    if stack.has_loki:
        yield LOKI, [own_port(), *contract()]
    if stack.collector:
        yield stack.collector, [own_port(), *contract()]
    if stack.kube_state_metrics.enabled:
        yield KUBE_STATE_METRICS, [own_port()]
    if stack.options.node_exporter.enabled:
        node = {"source_labels": [LABELS["node"]], "target_label": "node"}
        yield NODE_EXPORTER, [own_port(), node]


def own_port() -> Object:
    """Return the rule that keeps a part's one port with metrics."""
    name = "__meta_kubernetes_pod_container_port_name"
    return {"source_labels": [name], "action": "keep", "regex": "http"}


def _scrape_own(part: str, relabelling: list[Object], stack: Stack) -> Object:
    """Return the job of one of the stack's own parts."""
    selector = f"{NAME_LABEL}={part},{RELEASE_LABEL}={RELEASE}"
    found = {
        "role": "pod",
        "namespaces": {"names": [stack.namespace]},
        "selectors": [{"role": "pod", "label": selector}],
    }
    made: Object = {
        "job_name": part,
        "kubernetes_sd_configs": [found],
        "relabel_configs": relabelling,
    }
    return {**made, "honor_labels": True} if part == KUBE_STATE_METRICS else made


GROUP_VERSION = "monitoring.coreos.com/v1"
#: The kinds that the operator installs.
KINDS = ("PodMonitor", "PrometheusRule")


def monitoring(stack: Stack, found: ExistingPrometheus) -> Iterator[Object]:
    """Yield the monitors of all applications and of the parts that are ours, and the rules."""
    chosen: Object = {
        "selector": {"matchExpressions": [{"key": RELEASE_LABEL, "operator": "Exists"}]},
        "namespaceSelector": {"any": True},
    }
    endpoint = _endpoint("pods", scrape_applications(), keeps_labels=True)
    spec = {**chosen, "podMetricsEndpoints": [endpoint]}
    yield _object(stack, found, "PodMonitor", "rigel-applications", spec)
    for name, rules in own_parts(stack):
        endpoint = _endpoint(name, rules, keeps_labels=name == KUBE_STATE_METRICS)
        selector = {"matchLabels": {NAME_LABEL: name, RELEASE_LABEL: RELEASE}}
        spec = {"selector": selector, "podMetricsEndpoints": [endpoint]}
        yield _object(stack, found, "PodMonitor", name, spec)
    texts = map(yaml.safe_load, stack.boards.rules.values())
    groups = [group for text in texts for group in text["groups"]]
    if groups:
        yield _object(stack, found, "PrometheusRule", RELEASE, {"groups": groups})


def _endpoint(job: str, rules: Sequence[Object], *, keeps_labels: bool) -> Object:
    """Return what an operator scrapes, its fields in camel case; `job` is the contract's."""
    named = [*rules, {"target_label": "job", "replacement": job}]
    relabelings = [
        {re.sub(r"_(\w)", lambda match: match[1].upper(), key): value for key, value in one.items()}
        for one in named
    ]
    return {"honorLabels": keeps_labels, "relabelings": relabelings}


def _object(stack: Stack, found: ExistingPrometheus, kind: str, name: str, spec: Object) -> Object:
    made = stack.make(GROUP_VERSION, kind, name, spec=spec)
    made["metadata"]["labels"] |= {str(key): str(value) for key, value in found.labels.items()}
    return made
