"""NetworkPolicies: only the stack's parts, and users through the API server, may reach it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import selector
from rigel_k8s.objects.podoptions import OUTSIDE
from rigel_k8s.objects.pods import Object
from rigel_k8s.observability.manifests.scraping import KUBE_STATE_METRICS
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import GRAFANA, LOKI, PROMETHEUS, RELEASE
from rigel_k8s.observability.options import Component

#: The source of a cloud's API server, which does not run on the cluster's machines.
SYSTEM = {"namespaceSelector": {"matchLabels": {"kubernetes.io/metadata.name": "kube-system"}}}


def policies(stack: Stack) -> Iterator[Object]:
    """Yield the NetworkPolicies; they do not apply to pods in the machine's network."""
    yield _policy(stack, f"{RELEASE}-closed", {RELEASE_LABEL: RELEASE}, None)
    for part, sources in _sources(stack):
        yield _policy(stack, part, selector(part), sources)


def _sources(stack: Stack) -> Iterator[tuple[str, list[Object]]]:
    """Yield each part with the sources that may reach it; an empty source is any."""
    options = stack.options
    servers = [f"{address}/{128 if ':' in address else 32}" for address in stack.api_servers]
    outside: list[Object] = [*({"ipBlock": {"cidr": cidr}} for cidr in servers), SYSTEM]
    if stack.has_loki:
        writers = [stack.collector] if stack.collector else []
        inside = _parts([*writers, GRAFANA, PROMETHEUS])
        yield LOKI, _list_sources(options.loki, [*inside, *outside])
    if stack.has_prometheus:
        inside = _parts([GRAFANA, PROMETHEUS])
        yield PROMETHEUS, _list_sources(options.prometheus, [*inside, *outside])
    if stack.has_grafana:
        yield GRAFANA, _list_sources(options.grafana, outside)
    scraper = _parts([PROMETHEUS]) if stack.has_prometheus else [{"namespaceSelector": {}}]
    if stack.collector:
        yield stack.collector, scraper
    if stack.kube_state_metrics.enabled:
        yield KUBE_STATE_METRICS, scraper


def _list_sources(part: Component, sources: list[Object]) -> list[Object]:
    """Return the sources of a part; none if its Service is reachable from outside."""
    return [] if part.service_type in OUTSIDE else sources


def _parts(names: Sequence[str]) -> list[Object]:
    return [{"podSelector": {"matchLabels": selector(name)}} for name in names]


def _policy(stack: Stack, name: str, pods: dict[str, str], sources: list[Object] | None) -> Object:
    """Return a policy; None lets no pod in, an empty list every one."""
    allowed: Object = {"ports": [{"port": "http", "protocol": "TCP"}]}
    if sources:
        allowed["from"] = sources
    part = RELEASE if sources is None else name
    spec = {
        "podSelector": {"matchLabels": pods},
        "policyTypes": ["Ingress"],
        "ingress": [] if sources is None else [allowed],
    }
    return stack.make("networking.k8s.io/v1", "NetworkPolicy", name, part, spec=spec)
