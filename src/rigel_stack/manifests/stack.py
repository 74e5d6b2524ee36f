"""The options applied to one cluster: which parts are deployed, and where they keep data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import labels
from rigel_k8s.objects.pods import Object
from rigel_k8s.observability.names import (
    COMPONENT,
    LOKI,
    LOKI_PORT,
    PROMETHEUS,
    PROMETHEUS_PORT,
    RELEASE,
)
from rigel_k8s.observability.options import (
    DEFAULT_COLLECTOR,
    Existing,
    ExistingGrafana,
    ExistingLoki,
    ExistingPrometheus,
    Observability,
    Persistence,
    StackProgram,
    find_collector,
)


@attrs.frozen
class Boards:
    """What Grafana shows and Prometheus evaluates, as texts by file name."""

    dashboards: Mapping[str, str] = attrs.field(factory=dict)
    rules: Mapping[str, str] = attrs.field(factory=dict)


@attrs.frozen
class Stack:
    """The stack of one cluster.

    Attributes:
        options: of all applications together; options of only one application have no effect here.
        claims: whether the cluster gives storage to claims without a StorageClass.
        api_servers: source addresses of the API server's proxy, as far as they are known.
    """

    options: Observability
    namespace: str
    boards: Boards = attrs.field(factory=Boards)
    claims: bool = True
    api_servers: tuple[str, ...] = ()

    @property
    def existing(self) -> Existing:
        """The parts that the cluster has already."""
        return self.options.existing or Existing()

    @property
    def operator(self) -> ExistingPrometheus | None:
        """The prometheus-operator that is used, None for none."""
        return self.existing.prometheus

    @property
    def other_grafana(self) -> ExistingGrafana | None:
        """The existing Grafana that is used, None for none."""
        return self.existing.grafana

    @property
    def other_loki(self) -> ExistingLoki | None:
        """The existing Loki that is used, None for none."""
        return self.existing.loki

    @property
    def has_prometheus(self) -> bool:
        """Whether the stack has its own Prometheus."""
        return self.options.prometheus.enabled and self.operator is None

    @property
    def has_loki(self) -> bool:
        """Whether the stack has its own Loki."""
        return self.options.loki.enabled and self.other_loki is None

    @property
    def has_grafana(self) -> bool:
        """Whether the stack has its own Grafana."""
        return self.options.grafana.enabled and self.other_grafana is None

    @property
    def loki_url(self) -> str | None:
        """The URL that log lines are sent to, None if they are not collected."""
        if self.other_loki is not None:
            return self.other_loki.url.rstrip("/")
        return f"http://{LOKI}:{LOKI_PORT}" if self.has_loki else None

    @property
    def prometheus_url(self) -> str | None:
        """The URL from which Grafana reads metrics, None if it has none."""
        if self.operator is not None:
            return str(self.operator.url) if self.operator.url else None
        return f"http://{PROMETHEUS}:{PROMETHEUS_PORT}" if self.has_prometheus else None

    @property
    def collector(self) -> str | None:
        """The name of the log collector, None for none."""
        name = self.options.collector or DEFAULT_COLLECTOR
        return name if self.loki_url and find_collector(self.options, name).enabled else None

    @property
    def kube_state_metrics(self) -> StackProgram:
        """kube-state-metrics; an existing Prometheus has its own."""
        return self.options.kube_state_metrics or StackProgram(enabled=self.has_prometheus)

    def keeps(self, persistence: Persistence, *, default: bool) -> bool:
        """Return whether a part's data are on a claim."""
        if persistence.enabled is not None:
            return persistence.enabled
        asked = default or persistence.size is not None
        return persistence.storage_class is not None or (asked and self.claims)

    def make(
        self, api_version: str, kind: str, name: str, part: str | None = None, **fields: Any
    ) -> Object:
        """Return an object in its namespace, with the labels of a part: by default of its name."""
        metadata = {"name": name, "namespace": self.namespace, "labels": make_labels(part or name)}
        return {"apiVersion": api_version, "kind": kind, "metadata": metadata, **fields}

    def config_map(self, name: str, data: Mapping[str, str], part: str | None = None) -> Object:
        return self.make("v1", "ConfigMap", name, part, data=dict(data))


def make_labels(part: str) -> dict[str, str]:
    """Return the labels of a part's objects and pods."""
    return {**labels(part, RELEASE), **COMPONENT, RELEASE_LABEL: RELEASE}
