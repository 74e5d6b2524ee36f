"""Logs, metrics and dashboards as a release of their own: options to objects, pure."""

from rigel_k8s.manifests.observability.options import Grafana, Loki, Observability, Prometheus

__all__ = ["Grafana", "Loki", "Observability", "Prometheus"]
