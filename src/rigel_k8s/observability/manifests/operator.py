"""PodMonitors and rules for an existing prometheus-operator, instead of our Prometheus."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import yaml

from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.pods import Object
from rigel_k8s.observability.manifests.scraping import (
    KUBE_STATE_METRICS,
    own_parts,
    scrape_applications,
)
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.observability.options import ExistingPrometheus

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
