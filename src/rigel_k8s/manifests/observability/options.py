"""The options of the observability stack: checked today, deployed by a later version.

They are the peer's of both its generations: its own words, and release, chart and values of Helm.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import attrs

from rigel_k8s.manifests.fields import option
from rigel_k8s.manifests.scalars import ObjectName, Quantity, Retention

__all__ = ["Grafana", "Loki", "Observability", "Persistence", "Prometheus"]

ServiceType = Literal["ClusterIP", "NodePort", "LoadBalancer"]


@attrs.frozen(kw_only=True)
class Persistence:
    """Whether a part of the stack keeps its data on a claim."""

    enabled: bool = option("keep it", default=False)
    size: Quantity | None = option("how much storage is asked for")


@attrs.frozen(kw_only=True)
class Component:
    """What all parts of the stack have."""

    enabled: bool = option("deploy it", default=True)
    release: ObjectName | None = option("the Helm release that the peer installed it as")
    chart: str | None = option("the Helm chart that the peer installed")
    values: Mapping[str, Any] = option("values of that chart", {})


@attrs.frozen(kw_only=True)
class Grafana(Component):
    """Grafana."""

    admin_password: str | None = option("the administrator's password; better left to be generated")
    default_dashboards: bool = option("with dashboards for ROS", default=True)
    service_type: ServiceType | None = option("how it is reached")
    persistence: Persistence = attrs.field(factory=Persistence, metadata={"doc": "its data"})


@attrs.frozen(kw_only=True)
class Prometheus(Component):
    """Prometheus."""

    scrape_interval: Retention | None = option("time between two scrapes")
    evaluation_interval: Retention | None = option("time between two evaluations of the rules")
    retention: Retention | None = option("how long metrics are kept")
    service_type: ServiceType | None = option("how it is reached")


@attrs.frozen(kw_only=True)
class Loki(Component):
    """Loki."""

    retention: Retention | None = option("how long log lines are kept")
    service_type: ServiceType | None = option("how it is reached")
    persistence: Persistence = attrs.field(factory=Persistence, metadata={"doc": "its data"})


@attrs.frozen(kw_only=True)
class Observability:
    """Logs, metrics and dashboards; checked now, deployed by a later version."""

    enabled: bool = option("deploy the stack", default=False)
    namespace: ObjectName = option("where the stack lives", ObjectName("monitoring"))
    grafana: Grafana = attrs.field(factory=Grafana, metadata={"doc": "dashboards"})
    prometheus: Prometheus = attrs.field(factory=Prometheus, metadata={"doc": "metrics"})
    loki: Loki = attrs.field(factory=Loki, metadata={"doc": "logs"})
    node_exporter: bool = option("metrics of the machines", default=False)
    ros_metrics: bool = option("metrics of the ROS graph", default=False)
