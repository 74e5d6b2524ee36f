"""The images that watch a cluster: users, paths and start are those of upstream's images.

If upstream's image has a shell, this one has busybox; otherwise it has no shell either, so that
what works here works there. Certificate authorities and time zones are left out of all.
"""

from __future__ import annotations

from pathlib import Path

from rigel_lab.cluster.components import Components
from rigel_lab.cluster.observability import (
    KUBE_STATE_METRICS,
    LOKI,
    NODE_EXPORTER,
    OPERATOR,
    OTEL_COLLECTOR,
    PROMETHEUS,
)
from rigel_lab.cluster.oci import Image
from rigel_lab.cluster.upstream import find_program, shell, shorten_name, text, tools, users

LOKI_IMAGE = f"docker.io/grafana/loki:{LOKI.version}"
#: Upstream's last one. The module of its version is not available; a later one contains it.
PROMTAIL_IMAGE = "docker.io/grafana/promtail:3.6.11"
OTEL_COLLECTOR_IMAGE = f"docker.io/otel/opentelemetry-collector-k8s:{OTEL_COLLECTOR.version}"
PROMETHEUS_IMAGE = f"docker.io/prom/prometheus:v{PROMETHEUS.version}"
KUBE_STATE_METRICS_IMAGE = (
    f"registry.k8s.io/kube-state-metrics/kube-state-metrics:v{KUBE_STATE_METRICS.version}"
)
NODE_EXPORTER_IMAGE = f"quay.io/prometheus/node-exporter:v{NODE_EXPORTER.version}"
OPERATOR_IMAGE = f"quay.io/prometheus-operator/prometheus-operator:v{OPERATOR.version}"
RELOADER_IMAGE = f"quay.io/prometheus-operator/prometheus-config-reloader:v{OPERATOR.version}"

#: The account of programs that need no rights, in all images that have a name for it.
USER, USER_NUMBER = "nobody", 65534
#: Loki's own user.
LOKI_USER = 10001


def loki(components: Components) -> Image:
    """Return Loki's image, which has no shell."""
    return Image(
        shorten_name(LOKI_IMAGE),
        {
            **users(**{USER: USER_NUMBER}, loki=LOKI_USER),
            "usr/bin/loki": find_program(components, "loki"),
            "etc/loki/local-config.yaml": text(components, "loki.yaml"),
            "LICENSE": text(components, "loki-license"),
        },
        ["/usr/bin/loki"],
        command=["-config.file=/etc/loki/local-config.yaml"],
        user=str(LOKI_USER),
        owned=dict.fromkeys(("etc/loki", "loki", "loki/rules", "loki/rules-temp"), LOKI_USER),
    )


def promtail(components: Components) -> Image:
    """Return Promtail's image, which root runs, since only root may read all pods' logs."""
    return Image(
        shorten_name(PROMTAIL_IMAGE),
        {
            **users(**{USER: USER_NUMBER}),
            **shell(components),
            "usr/bin/promtail": find_program(components, "promtail"),
            "etc/promtail/config.yml": text(components, "promtail.yaml"),
            "LICENSE": text(components, "promtail-license"),
        },
        ["/usr/bin/promtail"],
        links=tools(components),
        command=["-config.file=/etc/promtail/config.yml"],
    )


def otel_collector(components: Components) -> Image:
    """Return the OpenTelemetry Collector's image, which has no shell."""
    return Image(
        shorten_name(OTEL_COLLECTOR_IMAGE),
        {
            "otelcol-k8s": find_program(components, "otelcol-k8s"),
            "LICENSE": text(components, "otel-collector-license"),
        },
        ["/otelcol-k8s"],
        user="10001",
    )


def prometheus(components: Components) -> Image:
    """Return Prometheus' image; its data are in a volume."""
    return Image(
        shorten_name(PROMETHEUS_IMAGE),
        {
            **users(**{USER: USER_NUMBER}),
            **shell(components),
            "bin/prometheus": find_program(components, "prometheus"),
            "bin/promtool": find_program(components, "promtool"),
            "etc/prometheus/prometheus.yml": text(components, "prometheus.yml"),
            "LICENSE": text(components, "prometheus-license"),
            "NOTICE": text(components, "prometheus-notice"),
        },
        ["/bin/prometheus"],
        links=tools(components),
        command=["--config.file=/etc/prometheus/prometheus.yml", "--storage.tsdb.path=/prometheus"],
        user=USER,
        owned={"etc/prometheus": USER_NUMBER, "prometheus": USER_NUMBER},
        volume="/prometheus",
    )


def kube_state_metrics(components: Components) -> Image:
    """Return kube-state-metrics' image, which has no shell."""
    return Image(
        shorten_name(KUBE_STATE_METRICS_IMAGE),
        {
            **users(**{USER: USER_NUMBER}),
            "kube-state-metrics": find_program(components, "kube-state-metrics"),
            "LICENSE": text(components, "kube-state-metrics-license"),
        },
        ["/kube-state-metrics", "--port=8080", "--telemetry-port=8081"],
        user=USER,
    )


def node_exporter(components: Components) -> Image:
    """Return node_exporter's image."""
    names = {"program": "node_exporter", "user": USER, "texts": "node-exporter"}
    return make_image(components, NODE_EXPORTER_IMAGE, **names)


def operator(components: Components) -> Image:
    """Return the image of the Prometheus operator."""
    names = {"program": "prometheus-operator", "inside": "operator", "user": str(USER_NUMBER)}
    return make_image(components, OPERATOR_IMAGE, **names)


def reloader(components: Components) -> Image:
    """Return the image of the program that reloads Prometheus after a change of configuration."""
    return make_image(components, RELOADER_IMAGE, program="prometheus-config-reloader", user=USER)


def make_image(
    components: Components,
    name: str,
    *,
    program: str,
    user: str,
    inside: str = "",
    texts: str = "prometheus-operator",
) -> Image:
    """Return an image of one program in /bin beside a shell, with its licence."""
    path = f"bin/{inside or program}"
    files: dict[str, Path | str] = {
        path: find_program(components, program),
        "LICENSE": text(components, f"{texts}-license"),
        "NOTICE": text(components, f"{texts}-notice"),
    }
    return Image(
        shorten_name(name),
        {**users(**{USER: USER_NUMBER}), **shell(components), **files},
        [f"/{path}"],
        links=tools(components),
        user=user,
    )


#: What nodes pull -> what makes it.
OBSERVABILITY_IMAGES = {
    LOKI_IMAGE: loki,
    PROMTAIL_IMAGE: promtail,
    OTEL_COLLECTOR_IMAGE: otel_collector,
    PROMETHEUS_IMAGE: prometheus,
    KUBE_STATE_METRICS_IMAGE: kube_state_metrics,
    NODE_EXPORTER_IMAGE: node_exporter,
}
OPERATOR_IMAGES = {OPERATOR_IMAGE: operator, RELOADER_IMAGE: reloader}
