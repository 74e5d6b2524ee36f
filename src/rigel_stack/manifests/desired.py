"""All objects of the stack on one cluster, as the desired state of its release."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import yaml

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import selector
from rigel_k8s.objects.podoptions import OUTSIDE
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.observability.names import GRAFANA, LABELS, LOKI, PROMETHEUS, RELEASE
from rigel_k8s.observability.options import ChartProgram
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_stack.manifests.otelcollector import OTEL_COLLECTOR, otel_collector
from rigel_stack.manifests.program import (
    ProgramDraft,
    list_loki_variables,
    load,
    read_file,
)
from rigel_stack.manifests.promtail import PROMTAIL, promtail
from rigel_stack.manifests.scraping import (
    KUBE_STATE_METRICS,
    NODE_EXPORTER,
    monitoring,
    write_prometheus_config,
)
from rigel_stack.manifests.stack import Stack

COLLECTORS = {OTEL_COLLECTOR: otel_collector, PROMTAIL: promtail}
#: The label that Grafana's sidecars look for by default.
SIDECAR_LABEL = {"grafana_dashboard": "1"}


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
        yield from ProgramDraft(stack, KUBE_STATE_METRICS, stack.kube_state_metrics).objects()
    if stack.options.node_exporter.enabled:
        yield from ProgramDraft(stack, NODE_EXPORTER, stack.options.node_exporter).objects()
    if stack.has_grafana:
        yield from grafana(stack)
    elif stack.other_grafana is not None:
        yield from dashboards(stack)
    if stack.options.network_policies:
        yield from policies(stack)


def loki(stack: Stack) -> Iterator[Object]:
    options = stack.options.loki
    labels = {"action": "index_label", "attributes": [*LABELS, "level"]}
    attributes = {"ignore_defaults": True, "attributes_config": [labels]}
    config = load("loki.yaml")
    config["limits_config"] |= {
        "retention_period": str(options.retention or "7d"),
        "otlp_config": {"resource_attributes": attributes},
    }
    text = yaml.safe_dump(config, sort_keys=False)
    draft = ProgramDraft(stack, LOKI, options, [stack.config_map(LOKI, {"loki.yaml": text})])
    draft.keep(options.persistence)
    return draft.objects()


def prometheus(stack: Stack) -> Iterator[Object]:
    options = stack.options.prometheus
    config = stack.config_map(PROMETHEUS, {"prometheus.yml": write_prometheus_config(stack)})
    rules = stack.config_map(f"{PROMETHEUS}-rules", stack.boards.rules, PROMETHEUS)
    draft = ProgramDraft(stack, PROMETHEUS, options, [config, rules])
    retention = options.retention or "15d"
    draft.container["args"].append(f"--storage.tsdb.retention.time={retention}")
    draft.keep(options.persistence)
    return draft.objects()


def grafana(stack: Stack) -> Iterator[Object]:
    """Yield Grafana's objects and the dashboards, without the Secret of its administrator."""
    options = stack.options.grafana
    texts = {
        "datasources.yaml": _datasources(stack),
        "dashboards.yaml": read_file("dashboards.yaml"),
    }
    draft = ProgramDraft(stack, GRAFANA, options, [stack.config_map(GRAFANA, texts)])
    draft.container["env"] += list_loki_variables(stack)
    shown = list(dashboards(stack))
    (volume,) = (one for one in draft.pod["volumes"] if one["name"] == "dashboards")
    volume["projected"]["sources"] = [
        {"configMap": {"name": one["metadata"]["name"], "items": [{"key": key, "path": key}]}}
        for one in shown
        for key in one["data"]
    ]
    draft.keep(options.persistence, default=False)
    yield from shown
    yield from draft.objects()


def _datasources(stack: Stack) -> str:
    known = load("datasources.yaml")
    prometheus = known["prometheus"] | {"url": stack.prometheus_url}
    interval = str(stack.options.prometheus.scrape_interval or "15s")
    prometheus["jsonData"]["timeInterval"] = interval
    loki = known["loki"] | {"url": stack.loki_url}
    existing = stack.other_loki
    if existing and existing.tenant:
        loki["jsonData"]["httpHeaderName1"] = "X-Scope-OrgID"
        loki["secureJsonData"] = {"httpHeaderValue1": existing.tenant}
    if existing and existing.secret:
        loki |= {"basicAuth": True, "basicAuthUser": "$LOKI_USER"}
        loki.setdefault("secureJsonData", {})["basicAuthPassword"] = "$LOKI_PASSWORD"
    sources = [source for source in (prometheus, loki) if source["url"]]
    return yaml.safe_dump({"apiVersion": 1, "datasources": sources}, sort_keys=False)


def dashboards(stack: Stack) -> Iterator[Object]:
    """Yield a ConfigMap for each dashboard: all together may be too large for one.

    Our Grafana mounts them, another Grafana's sidecar finds them.
    """
    if not stack.options.grafana.default_dashboards:
        return
    other = stack.other_grafana
    labels = {str(k): str(v) for k, v in other.labels.items()} if other else {}
    for file, text in sorted(stack.boards.dashboards.items()):
        made = stack.config_map(f"dashboard-{file.removesuffix('.json')}", {file: text}, GRAFANA)
        made["metadata"]["labels"] |= labels or SIDECAR_LABEL
        if other and other.folder:
            made["metadata"]["annotations"] = {"grafana_folder": other.folder}
        yield made


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


def _list_sources(part: ChartProgram, sources: list[Object]) -> list[Object]:
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
