"""Logs, metrics and dashboards as a release of their own: options to objects, pure."""

from rigel_k8s.observability.options import Observability, ObservabilityOptions

__all__ = ["Observability", "ObservabilityOptions"]
