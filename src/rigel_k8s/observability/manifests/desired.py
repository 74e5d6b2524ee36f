"""All objects of the stack on one cluster, as the desired state of its release."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from rigel_k8s.objects.refs import ref_of
from rigel_k8s.observability.manifests.dashboards import dashboards
from rigel_k8s.observability.manifests.frame import Object
from rigel_k8s.observability.manifests.grafana import grafana
from rigel_k8s.observability.manifests.loki import loki
from rigel_k8s.observability.manifests.machines import kube_state_metrics, node_exporter
from rigel_k8s.observability.manifests.operator import monitoring
from rigel_k8s.observability.manifests.otelcollector import OTEL_COLLECTOR, otel_collector
from rigel_k8s.observability.manifests.policies import policies
from rigel_k8s.observability.manifests.prometheus import prometheus
from rigel_k8s.observability.manifests.promtail import PROMTAIL, promtail
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.release.types import Desired, ReleaseId

COLLECTORS: Mapping[str, Callable[[Stack], Iterator[Object]]] = {
    OTEL_COLLECTOR: otel_collector,
    PROMTAIL: promtail,
}


def stack_release(stack: Stack, options: Mapping[str, Any]) -> Desired:
    """Return the desired state of the stack's release.

    Args:
        options: as plain data, kept in the revision: the next application's are merged over them.
    """
    made = tuple(_objects(stack))
    return Desired(
        ReleaseId(stack.namespace, RELEASE),
        made,
        options=options,
        create_namespace=True,
        protected=frozenset(
            ref_of(item) for item in made if item["kind"] == "PersistentVolumeClaim"
        ),
    )


def _objects(stack: Stack) -> Iterator[Object]:
    if stack.has_loki:
        yield from loki(stack)
    if stack.collector:
        yield from COLLECTORS[stack.collector](stack)
    if stack.has_prometheus:
        yield from prometheus(stack)
    if stack.operator is not None:
        yield from monitoring(stack, stack.operator)
    if stack.kube_state_metrics.enabled:
        yield from kube_state_metrics(stack)
    if stack.options.node_exporter.enabled:
        yield from node_exporter(stack)
    if stack.has_grafana:
        yield from grafana(stack)
    elif stack.other_grafana is not None:
        yield from dashboards(stack)
    if stack.options.network_policies:
        yield from policies(stack)
