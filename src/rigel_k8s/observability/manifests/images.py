"""The images of the stack: upstream's, each of one version; a part's option `image` replaces it."""

from __future__ import annotations

LOKI_IMAGE = "docker.io/grafana/loki:3.7.8"
#: The last version: its maintenance has ended.
PROMTAIL_IMAGE = "docker.io/grafana/promtail:3.6.11"
OTEL_COLLECTOR_IMAGE = "docker.io/otel/opentelemetry-collector-k8s:0.158.0"
#: The line with long-term support.
PROMETHEUS_IMAGE = "docker.io/prom/prometheus:v3.13.3"
KUBE_STATE_METRICS_IMAGE = "registry.k8s.io/kube-state-metrics/kube-state-metrics:v2.18.0"
NODE_EXPORTER_IMAGE = "quay.io/prometheus/node-exporter:v1.12.1"
GRAFANA_IMAGE = "docker.io/grafana/grafana:13.2.3"
