"""The options of the observability stack, and of what each application adds to it.

They include the options of both generations of src.plugin; release, chart and values are Helm's,
which is not used here. docs/reference.md is made from the fields' documentation.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import attrs

from rigel_k8s.objects.fields import option, required_field, true_is_default
from rigel_k8s.objects.overlay import simplify
from rigel_k8s.objects.podoptions import Machines, ServiceType
from rigel_k8s.objects.resources import Resources
from rigel_k8s.objects.scalars import (
    DottedName,
    Duration,
    HostPort,
    ImageRef,
    LabelKey,
    LabelValue,
    ObjectName,
    Quantity,
    Retention,
    RosName,
    Url,
)

DEFAULT_COLLECTOR = "otel-collector"


@attrs.frozen(kw_only=True)
class Persistence:
    """Whether a part of the stack keeps its data on a claim, which outlives the stack."""

    enabled: bool | None = option(
        "keep the data on a claim (default: true for Loki and Prometheus, if the cluster has a"
        " default StorageClass or `storage_class` is set)"
    )
    size: Quantity | None = option("the size of the claim (default 10Gi, Grafana 1Gi)")
    storage_class: str | None = option("a StorageClass (default: the cluster's)")


@attrs.frozen(kw_only=True)
class Program:
    """A program, whether of the stack or of an application."""

    image: ImageRef | None = option("its image, from a registry of your own")
    resources: Resources = attrs.field(
        factory=Resources, metadata={"doc": "requests and limits, merged over the defaults"}
    )


@attrs.frozen(kw_only=True)
class StackProgram(Program):
    """A program of the stack."""

    enabled: bool = option("deploy it", default=True)


def stack_program(value: bool | StackProgram) -> StackProgram:  # noqa: FBT001 - as the Rigelfile has it
    """Return the options of a part that may be written as true or false."""
    return value if isinstance(value, StackProgram) else StackProgram(enabled=value)


@attrs.frozen(kw_only=True)
class ChartProgram(StackProgram):
    """A part with a page of its own; release, chart and values are accepted but not used."""

    release: ObjectName | None = option(
        "the Helm release that src.plugin installed it as; not used"
    )
    chart: str | None = option("the Helm chart that src.plugin installed; not used")
    values: Mapping[str, Any] = option("values of that chart; not used", {})
    service_type: ServiceType | None = option(
        "type of its Service (default ClusterIP: not reachable from outside of the cluster)"
    )


@attrs.frozen(kw_only=True)
class Grafana(ChartProgram):
    """Grafana."""

    admin_password: str | None = option(
        "the administrator's password (default: a random one, which is safer)"
    )
    default_dashboards: bool = option("deploy the dashboards for ROS", default=True)
    persistence: Persistence = attrs.field(
        factory=Persistence,
        metadata={"doc": "storage for changes that users make; dashboards need none"},
    )


@attrs.frozen(kw_only=True)
class Prometheus(ChartProgram):
    """Prometheus."""

    scrape_interval: Retention | None = option("time between two scrapes (default 15s)")
    evaluation_interval: Retention | None = option(
        "time between two evaluations of the rules (default 15s)"
    )
    retention: Retention | None = option("how long metrics are kept (default 15d)")
    alertmanagers: list[HostPort] = option("Alertmanagers that alerts are sent to", [])
    persistence: Persistence = attrs.field(factory=Persistence, metadata={"doc": "its data"})


@attrs.frozen(kw_only=True)
class Loki(ChartProgram):
    """Loki."""

    retention: Retention | None = option(
        "how long log lines are kept; 0: forever (default 7d, at least 24h)"
    )
    persistence: Persistence = attrs.field(factory=Persistence, metadata={"doc": "its data"})


@attrs.frozen(kw_only=True)
class RosMetrics(Program):
    """The exporter of each application: it measures the health of its ROS graph."""

    topics: list[RosName] = option(
        "topics to subscribe to, for rate, bandwidth and age; no others are subscribed to", []
    )
    diagnostics: bool = option("export the levels of /diagnostics", default=False)
    clock: bool = option("export the age of /clock", default=False)
    tf: bool = option("export the age of each transform of /tf", default=False)
    interval: Duration | None = option("time between two looks at the graph (default 10s)")


@attrs.frozen(kw_only=True)
class ExistingPrometheus:
    """An existing prometheus-operator: it gets PodMonitors and a PrometheusRule."""

    labels: Mapping[LabelKey, LabelValue] = option(
        "labels that it selects by, such as {release: kube-prometheus-stack}", {}
    )
    url: Url | None = option("its URL; only needed for a Grafana of this stack")


@attrs.frozen(kw_only=True)
class ExistingLoki:
    """An existing Loki: log lines are sent to it."""

    url: Url = required_field("its URL, such as http://loki.logging:3100")
    tenant: str | None = option("X-Scope-OrgID, if it has tenants")
    secret: DottedName | None = option(
        "a Secret in the stack's namespace with `username` and `password`, if it needs them"
    )


@attrs.frozen(kw_only=True)
class ExistingGrafana:
    """An existing Grafana: its sidecar loads the dashboards."""

    labels: Mapping[LabelKey, LabelValue] = option(
        'labels that its sidecar looks for (default {grafana_dashboard: "1"})', {}
    )
    folder: str | None = option("the annotation grafana_folder of the dashboards")


@attrs.frozen(kw_only=True)
class Existing:
    """Parts that the cluster has already: each is used instead of one of this stack."""

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

    example: ClassVar[str] = "{enabled: true}"

    enabled: bool = option("deploy the stack if it is not up to date", default=False)
    namespace: ObjectName | None = option(
        "the stack's namespace (default: that of the existing stack, otherwise monitoring)"
    )
    collector: Literal["otel-collector", "promtail"] | None = option(
        "the program that reads the log lines (default otel-collector)"
    )
    placement: Machines = attrs.field(
        factory=Machines,
        metadata={"doc": "where Loki, Prometheus, Grafana and kube-state-metrics run"},
    )
    grafana: Grafana = attrs.field(factory=Grafana, metadata={"doc": "dashboards"})
    prometheus: Prometheus = attrs.field(factory=Prometheus, metadata={"doc": "metrics"})
    loki: Loki = attrs.field(factory=Loki, metadata={"doc": "logs"})
    otel_collector: StackProgram = option(
        "the collector, if it is the OpenTelemetry Collector",
        default=True,
        accepts=bool | StackProgram,
        converter=stack_program,
    )
    promtail: StackProgram = option(
        "the collector, if it is Promtail",
        default=True,
        accepts=bool | StackProgram,
        converter=stack_program,
    )
    kube_state_metrics: StackProgram | None = option(
        "metrics of Kubernetes' pods and machines (default: if this stack has a Prometheus)",
        accepts=bool | StackProgram | None,
        converter=attrs.converters.optional(stack_program),
    )
    node_exporter: StackProgram = option(
        "metrics of the machines",
        default=False,
        accepts=bool | StackProgram,
        converter=stack_program,
    )
    ros_metrics: bool | RosMetrics | None = option(
        "metrics of this application's ROS graph (default: if `enabled` is true)"
    )
    existing: Existing | None = option("parts that the cluster has already, used instead")
    collect: Literal["releases", "all"] | None = option(
        "whose log lines are read: pods of releases (the default), or all pods of the cluster"
    )
    network_policies: bool = option(
        "let only the stack's own parts and the API server reach it", default=True
    )

    @property
    def exporter(self) -> RosMetrics | None:
        """The options of each application's exporter, None if it has none."""
        if not self.enabled or self.ros_metrics is False:
            return None
        return self.ros_metrics if isinstance(self.ros_metrics, RosMetrics) else RosMetrics()


def find_collector(options: Observability, name: str) -> StackProgram:
    part: StackProgram = getattr(options, name.replace("-", "_"))
    return part


@attrs.frozen(kw_only=True)
class ObservabilityOptions(Observability):
    """The same as a job of its own."""

    enabled: bool = option("deploy the stack", default=True)


#: Options of a single application, and where the stack is instead of what it is.
OWN = ("enabled", "ros_metrics", "namespace")


@attrs.frozen
class StackRequest:
    """What a job requests of the stack.

    It stays plain data, since only options that are set change a stack: it is merged over the data
    of other jobs, and all together become options.

    Attributes:
        options: those that the job sets for the stack, without a password.
        namespace: the stack's namespace, None for that of the existing stack.
        password: Grafana's, None to create one.
    """

    options: Mapping[str, Any]
    namespace: str | None = None
    password: str | None = attrs.field(default=None, repr=False)


def request_of(raw: Mapping[str, Any]) -> StackRequest:
    """Return what a job's `observability`, as plain data, requests of the stack."""
    options: dict[str, Any] = {key: value for key, value in simplify(raw).items() if key not in OWN}
    password = None
    if isinstance(options.get("grafana"), dict):
        password = options["grafana"].pop("admin_password", None)
    namespace = raw.get("namespace")
    return StackRequest(
        options,
        str(namespace) if namespace else None,
        str(password) if password else None,
    )
