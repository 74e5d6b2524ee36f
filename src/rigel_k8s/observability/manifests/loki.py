"""Loki as one process on one claim; lines older than `retention` are deleted, not only hidden."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.manifests.frame import (
    Object,
    container,
    data_volume,
    http_probes,
    load,
    mount,
)
from rigel_k8s.observability.manifests.images import LOKI_IMAGE
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import LABELS, LOKI, LOKI_PORT

RETENTION = "7d"
SIZE = "10Gi"
USER = 10001
DATA, CONFIG = "/loki", "/etc/loki"
DEFAULTS = {
    "requests": {"cpu": "50m", "memory": "192Mi"},
    "limits": {"memory": "1Gi"},
}

#: The garbage collector works harder if the container's limit is near.
MEMORY = {"resourceFieldRef": {"resource": "limits.memory"}}


def loki(stack: Stack) -> Iterator[Object]:
    """Yield Loki's objects."""
    frame, options = stack.frame, stack.options.loki
    config = frame.config_map(LOKI, {"loki.yaml": configuration(stack)}, LOKI)
    yield frame.account(LOKI)
    yield config
    if stack.keeps(options.persistence, default=True):
        yield frame.claim(LOKI, options.persistence, SIZE)
    yield frame.service(LOKI, LOKI_PORT, options.service_type)
    yield frame.deployment(LOKI, _pod(stack), [config])


def configuration(stack: Stack) -> str:
    """Return loki.yaml."""
    made = load("loki.yaml")
    made["limits_config"] |= {
        "retention_period": str(stack.options.loki.retention or RETENTION),
        "otlp_config": {
            "resource_attributes": {
                "ignore_defaults": True,
                "attributes_config": [
                    {"action": "index_label", "attributes": [*LABELS, "level"]},
                ],
            }
        },
    }
    return yaml.safe_dump(made, sort_keys=False)


def _pod(stack: Stack) -> Object:
    options = stack.options.loki
    main = container(
        LOKI,
        options,
        LOKI_IMAGE,
        DEFAULTS,
        args=[f"-config.file={CONFIG}/loki.yaml"],
        env=[{"name": "GOMEMLIMIT", "valueFrom": MEMORY}],
        ports=[{"name": "http", "containerPort": LOKI_PORT}],
        # The compactor first writes to /tmp what it will delete.
        volumeMounts=[
            mount("config", CONFIG, read_only=True),
            mount("data", DATA),
            mount("tmp", "/tmp"),
        ],
        **http_probes("/ready"),
    )
    return {
        "serviceAccountName": LOKI,
        "securityContext": pod_context(USER),
        # Before it ends, it writes what it has in memory.
        "terminationGracePeriodSeconds": 60,
        "containers": [main],
        "volumes": [
            {"name": "config", "configMap": {"name": LOKI}},
            data_volume(LOKI, kept=stack.keeps(options.persistence, default=True)),
            {"name": "tmp", "emptyDir": {}},
        ],
    }
