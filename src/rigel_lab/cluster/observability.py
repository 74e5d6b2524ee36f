"""The programs that watch a cluster, as `--with observability` downloads or builds them.

extras.yaml describes their images. All are built as upstream builds them but without C
libraries: Promtail reads no systemd journal, Prometheus has no pages of its own. Loki's releases do
not contain the configuration and licence of its image, and kube-state-metrics is released only as
an image: these are always built.
"""

from __future__ import annotations

from rigel_lab.cluster.gobuild import GoBuild
from rigel_lab.cluster.releases import Release

#: Where programs of Prometheus' family keep their version.
VERSION = "github.com/prometheus/common/version.Version"
#: Where Loki's do.
LOKI_MODULE = "github.com/grafana/loki/v3"
LOKI_VERSION = f"{LOKI_MODULE}/pkg/util/build.Version"

LOKI = GoBuild(
    "loki",
    "3.7.8",
    (f"{LOKI_MODULE}/cmd/loki",),
    stamps=(f"{LOKI_VERSION}=3.7.8",),
    files={"loki-license": "LICENSE", "loki.yaml": "cmd/loki/loki-docker-config.yaml"},
    module=LOKI_MODULE,
    minutes=4,
)
#: The newest of the last line that contains Promtail.
PROMTAIL = GoBuild(
    "promtail",
    "3.6.15",
    (f"{LOKI_MODULE}/clients/cmd/promtail",),
    stamps=(f"{LOKI_VERSION}=3.6.15",),
    files={
        "promtail-license": "LICENSE",
        "promtail.yaml": "clients/cmd/promtail/promtail-docker-config.yaml",
    },
    module=LOKI_MODULE,
    minutes=3,
)
PROMETHEUS_MODULE = "github.com/prometheus/prometheus"
PROMETHEUS = GoBuild(
    "prometheus",
    "3.13.3",
    (f"{PROMETHEUS_MODULE}/cmd/prometheus", f"{PROMETHEUS_MODULE}/cmd/promtool"),
    stamps=(f"{VERSION}=3.13.3",),
    files={
        "prometheus-license": "LICENSE",
        "prometheus-notice": "NOTICE",
        "prometheus.yml": "documentation/examples/prometheus.yml",
    },
    module_version="0.313.3",
    minutes=3,
    release=Release(
        "https://github.com/prometheus/prometheus/releases/download/v3.13.3",
        "prometheus-3.13.3.linux-{arch}.tar.gz",
        sums="sha256sums.txt",
    ),
)
NODE_EXPORTER = GoBuild(
    "node-exporter",
    "1.12.1",
    ("github.com/prometheus/node_exporter",),
    stamps=(f"{VERSION}=1.12.1",),
    files={"node-exporter-license": "LICENSE", "node-exporter-notice": "NOTICE"},
    release=Release(
        "https://github.com/prometheus/node_exporter/releases/download/v1.12.1",
        "node_exporter-1.12.1.linux-{arch}.tar.gz",
        sums="sha256sums.txt",
    ),
)
KUBE_STATE_METRICS = GoBuild(
    "kube-state-metrics",
    "2.18.0",
    ("k8s.io/kube-state-metrics/v2",),
    stamps=(f"{VERSION}=v2.18.0",),
    files={"kube-state-metrics-license": "LICENSE"},
)
OPERATOR_MODULE = "github.com/prometheus-operator/prometheus-operator"
#: Prometheus by this program is optional; it is offered to try that.
OPERATOR = GoBuild(
    "prometheus-operator",
    "0.92.1",
    (f"{OPERATOR_MODULE}/cmd/operator", f"{OPERATOR_MODULE}/cmd/prometheus-config-reloader"),
    stamps=(f"{VERSION}=0.92.1",),
    renamed={"operator": "prometheus-operator"},
    files={
        "prometheus-operator-license": "LICENSE",
        "prometheus-operator-notice": "NOTICE",
        "prometheus-operator.yaml": "bundle.yaml",
    },
)

#: Upstream puts its distributions together from modules; this one has what logs need of the one for
#: Kubernetes. It is the newest version of which all those modules are available.
OTEL_COLLECTOR = GoBuild(
    "otel-collector",
    "0.158.0",
    ("./otelcol-k8s",),
    stamps=("main.version=0.158.0",),
    files={"otel-collector-license": "LICENSE"},
    module="go.opentelemetry.io/collector/otelcol",
    minutes=2,
)

#: The longest first: what it shares with the others is compiled once.
OBSERVABILITY = (LOKI, PROMTAIL, OTEL_COLLECTOR, PROMETHEUS, KUBE_STATE_METRICS, NODE_EXPORTER)
