"""The options of the observability stack, and of what each application adds to it.

The words of both generations of src.plugin are among them; release, chart and values are Helm's,
which nothing here uses. Every field says what it is for; docs/reference.md is made from it.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import attrs

from rigel_k8s.objects.fields import option, required_field, true_is_default
from rigel_k8s.objects.resources import Resources
from rigel_k8s.objects.scalars import (
    Duration,
    ImageRef,
    LabelKey,
    LabelValue,
    ObjectName,
    Quantity,
    Retention,
    RosName,
)

ServiceType = Literal["ClusterIP", "NodePort", "LoadBalancer"]


@attrs.frozen(kw_only=True)
class Persistence:
    """Whether a part of the stack keeps its data on a claim, which outlives the stack."""

    enabled: bool | None = option(
        "keep it on a claim (default: Loki and Prometheus do, where the cluster has a default"
        " StorageClass or `storage_class` is given)"
    )
    size: Quantity | None = option("how much storage is asked for (default 10Gi, Grafana 1Gi)")
    storage_class: str | None = option("a StorageClass; left out: the cluster's default")


@attrs.frozen(kw_only=True)
class Part:
    """A program of the stack."""

    enabled: bool = option("deploy it", default=True)
    image: ImageRef | None = option("its image, from a registry of your own")
    resources: Resources = attrs.field(
        factory=Resources, metadata={"doc": "requests and limits, laid over the defaults"}
    )


def part_of(value: bool | Part) -> Part:  # noqa: FBT001 - as the Rigelfile has it
    """Return the options of a part that may be written as true or false."""
    return value if isinstance(value, Part) else Part(enabled=value)


def optional_part_of(value: bool | Part | None) -> Part | None:  # noqa: FBT001
    """Return the same, and None where the Rigelfile leaves it open."""
    return None if value is None else part_of(value)


@attrs.frozen(kw_only=True)
class Component(Part):
    """A part that people look at; release, chart and values are accepted and not used."""

    release: ObjectName | None = option(
        "the Helm release that src.plugin installed it as; not used"
    )
    chart: str | None = option("the Helm chart that src.plugin installed; not used")
    values: Mapping[str, Any] = option("values of that chart; not used", {})
    service_type: ServiceType | None = option(
        "how it is reached (default ClusterIP: not from outside of the cluster)"
    )


@attrs.frozen(kw_only=True)
class Grafana(Component):
    """Grafana."""

    admin_password: str | None = option("the administrator's password; better left to be generated")
    default_dashboards: bool = option("with dashboards for ROS", default=True)
    persistence: Persistence = attrs.field(
        factory=Persistence, metadata={"doc": "what people change in it; dashboards need none"}
    )


@attrs.frozen(kw_only=True)
class Prometheus(Component):
    """Prometheus."""

    scrape_interval: Retention | None = option("time between two scrapes (default 15s)")
    evaluation_interval: Retention | None = option(
        "time between two evaluations of the rules (default 15s)"
    )
    retention: Retention | None = option("how long metrics are kept (default 15d)")
    alertmanagers: list[str] = option("HOST:PORT of Alertmanagers that alerts are sent to", [])
    persistence: Persistence = attrs.field(factory=Persistence, metadata={"doc": "its data"})


@attrs.frozen(kw_only=True)
class Loki(Component):
    """Loki."""

    retention: Retention | None = option(
        "how long log lines are kept; 0: for ever (default 7d, the least is 24h)"
    )
    persistence: Persistence = attrs.field(factory=Persistence, metadata={"doc": "its data"})


@attrs.frozen(kw_only=True)
class RosMetrics:
    """The exporter that each application has beside its nodes: health of its ROS graph."""

    image: ImageRef | None = option("its image, from a registry of your own")
    resources: Resources = attrs.field(
        factory=Resources, metadata={"doc": "requests and limits, laid over the defaults"}
    )
    topics: list[RosName] = option(
        "topics to subscribe to for rate, bandwidth and age; no other is subscribed to", []
    )
    diagnostics: bool = option("levels of /diagnostics", default=False)
    clock: bool = option("age of /clock", default=False)
    tf: bool = option("age of each transform of /tf", default=False)
    interval: Duration | None = option("time between two looks at the graph (default 10s)")


@attrs.frozen(kw_only=True)
class ExistingPrometheus:
    """A prometheus-operator that is there: it gets PodMonitors and a PrometheusRule."""

    labels: Mapping[LabelKey, LabelValue] = option(
        "labels that it selects by, {release: kube-prometheus-stack} say", {}
    )
    url: str | None = option("where it answers; only a Grafana of this stack asks for it")


@attrs.frozen(kw_only=True)
class ExistingLoki:
    """A Loki that is there: log lines are sent to it."""

    url: str = required_field("where it answers, http://loki.logging:3100 say")
    tenant: str | None = option("X-Scope-OrgID, where it has tenants")
    secret: ObjectName | None = option(
        "a Secret in the stack's namespace with `username` and `password`, where it asks for them"
    )


@attrs.frozen(kw_only=True)
class ExistingGrafana:
    """A Grafana that is there: its sidecar loads the dashboards."""

    labels: Mapping[LabelKey, LabelValue] = option(
        'labels that its sidecar looks for (default {grafana_dashboard: "1"})', {}
    )
    folder: str | None = option("the annotation grafana_folder of the dashboards")


@attrs.frozen(kw_only=True)
class Existing:
    """What the cluster has already: each that is named is used instead of one of ours."""

    prometheus: ExistingPrometheus | None = option(
        "a prometheus-operator",
        default=False,
        accepts=bool | ExistingPrometheus,
        converter=true_is_default(ExistingPrometheus),
    )
    loki: ExistingLoki | None = option("a Loki")
    grafana: ExistingGrafana | None = option(
        "a Grafana with a dashboard sidecar",
        default=False,
        accepts=bool | ExistingGrafana,
        converter=true_is_default(ExistingGrafana),
    )


@attrs.frozen(kw_only=True)
class Observability:
    """Logs, metrics and dashboards: one stack for all applications of a cluster."""

    enabled: bool = option("deploy the stack, or see that it is there", default=False)
    namespace: ObjectName | None = option(
        "where the stack lives (default: where it is already, else monitoring)"
    )
    collector: Literal["promtail", "alloy"] | None = option(
        "what reads the log lines (default promtail)"
    )
    grafana: Grafana = attrs.field(factory=Grafana, metadata={"doc": "dashboards"})
    prometheus: Prometheus = attrs.field(factory=Prometheus, metadata={"doc": "metrics"})
    loki: Loki = attrs.field(factory=Loki, metadata={"doc": "logs"})
    promtail: Part = option(
        "the collector, where it is Promtail",
        default=True,
        accepts=bool | Part,
        converter=part_of,
    )
    alloy: Part = option(
        "the collector, where it is Alloy", default=True, accepts=bool | Part, converter=part_of
    )
    kube_state_metrics: Part | None = option(
        "what Kubernetes knows of pods and nodes (default: with a Prometheus of this stack)",
        accepts=bool | Part | None,
        converter=optional_part_of,
    )
    node_exporter: Part = option(
        "metrics of the machines", default=False, accepts=bool | Part, converter=part_of
    )
    ros_metrics: bool | RosMetrics | None = option(
        "metrics of this application's ROS graph (default: with `enabled: true`)"
    )
    existing: Existing | None = option("what the cluster has already and shall be used instead")
    collect: Literal["releases", "all"] | None = option(
        "whose log lines: pods of releases (the default), or all pods of the cluster"
    )
    network_policies: bool = option(
        "let nobody but the stack's own parts and the API server reach it", default=True
    )

    @property
    def exporter(self) -> RosMetrics | None:
        """What each application's exporter shall do, None where it has none."""
        if not self.enabled or self.ros_metrics is False:
            return None
        return self.ros_metrics if isinstance(self.ros_metrics, RosMetrics) else RosMetrics()


@attrs.frozen(kw_only=True)
class ObservabilityOptions(Observability):
    """The same as a job of its own."""

    enabled: bool = option("deploy the stack", default=True)
