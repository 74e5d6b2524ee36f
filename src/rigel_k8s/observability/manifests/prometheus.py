"""Prometheus: the metrics of pods, machines and ROS, and the rules over them."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.manifests.frame import (
    Object,
    container,
    data_volume,
    http_probes,
    mount,
    rule,
)
from rigel_k8s.observability.manifests.images import PROMETHEUS_IMAGE
from rigel_k8s.observability.manifests.scraping import configuration
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import PROMETHEUS, PROMETHEUS_PORT

RETENTION = "15d"
SIZE = "10Gi"
USER = 65534
CONFIG, RULES, DATA = "/etc/prometheus", "/etc/prometheus-rules", "/prometheus"
DEFAULTS = {
    "requests": {"cpu": "50m", "memory": "256Mi"},
    "limits": {"memory": "2Gi"},
}
LOOK = ["get", "list", "watch"]


def prometheus(stack: Stack) -> Iterator[Object]:
    """Yield Prometheus' objects."""
    frame, options = stack.frame, stack.options.prometheus
    config = frame.config_map(
        PROMETHEUS, {"prometheus.yml": configuration(stack, RULES)}, PROMETHEUS
    )
    rules = frame.config_map(f"{PROMETHEUS}-rules", stack.boards.rules, PROMETHEUS)
    yield frame.account(PROMETHEUS)
    yield from frame.rights(
        PROMETHEUS,
        [rule("", ["pods", "nodes"], LOOK), rule("", ["nodes/metrics"], ["get"])],
    )
    yield config
    yield rules
    if stack.keeps(options.persistence, default=True):
        yield frame.claim(PROMETHEUS, options.persistence, SIZE)
    yield frame.service(PROMETHEUS, PROMETHEUS_PORT, options.service_type)
    yield frame.deployment(PROMETHEUS, _pod(stack), [config, rules])


def _pod(stack: Stack) -> Object:
    options = stack.options.prometheus
    main = container(
        PROMETHEUS,
        options,
        PROMETHEUS_IMAGE,
        DEFAULTS,
        args=[
            f"--config.file={CONFIG}/prometheus.yml",
            f"--storage.tsdb.path={DATA}",
            f"--storage.tsdb.retention.time={options.retention or RETENTION}",
        ],
        ports=[{"name": "http", "containerPort": PROMETHEUS_PORT}],
        volumeMounts=[
            mount("config", CONFIG, read_only=True),
            mount("rules", RULES, read_only=True),
            mount("data", DATA),
        ],
        **http_probes("/-/ready"),
    )
    return {
        "serviceAccountName": PROMETHEUS,
        "automountServiceAccountToken": True,
        "securityContext": pod_context(USER),
        "terminationGracePeriodSeconds": 60,
        "containers": [main],
        "volumes": [
            {"name": "config", "configMap": {"name": PROMETHEUS}},
            {"name": "rules", "configMap": {"name": f"{PROMETHEUS}-rules"}},
            data_volume(PROMETHEUS, kept=stack.keeps(options.persistence, default=True)),
        ],
    }
