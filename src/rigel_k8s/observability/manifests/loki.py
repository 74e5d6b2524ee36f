"""Loki as one process on one claim; lines older than `retention` are deleted, not only hidden."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.manifests.frame import Object, container, http_probes, mount
from rigel_k8s.observability.manifests.images import LOKI_IMAGE
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.manifests.storage import data_volume
from rigel_k8s.observability.names import LABELS, LOKI, LOKI_PORT

RETENTION = "7d"
SIZE = "10Gi"
USER = 10001
DATA, CONFIG = "/loki", "/etc/loki"
DEFAULTS = {
    "requests": {"cpu": "50m", "memory": "192Mi"},
    "limits": {"memory": "1Gi"},
}


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
    made: Object = {
        "auth_enabled": False,
        "analytics": {"reporting_enabled": False},
        "server": {
            "http_listen_port": LOKI_PORT,
            # Only Loki itself uses gRPC.
            "grpc_listen_address": "127.0.0.1",
            "grpc_listen_port": 9095,
            "log_level": "warn",
        },
        "common": {
            "instance_addr": "127.0.0.1",
            "path_prefix": DATA,
            "replication_factor": 1,
            "ring": {"kvstore": {"store": "inmemory"}},
            "storage": {
                "filesystem": {
                    "chunks_directory": f"{DATA}/chunks",
                    "rules_directory": f"{DATA}/rules",
                }
            },
        },
        "schema_config": {"configs": [_schema()]},
        # It is alone in the ring, so it is ready when it is up.
        "ingester": {"lifecycler": {"min_ready_duration": "0s", "final_sleep": "0s"}},
        "compactor": {
            "working_directory": f"{DATA}/compactor",
            "retention_enabled": True,
            "delete_request_store": "filesystem",
        },
        "limits_config": _limits(stack),
    }
    return yaml.safe_dump(made, sort_keys=False)


def _schema() -> Object:
    return {
        "from": "2024-01-01",
        "store": "tsdb",
        "object_store": "filesystem",
        "schema": "v13",
        "index": {"prefix": "index_", "period": "24h"},
    }


def _limits(stack: Stack) -> Object:
    return {
        "retention_period": str(stack.options.loki.retention or RETENTION),
        # The labels are those of the contract, and the collector detects the level.
        "discover_service_name": [],
        "discover_log_levels": False,
        "otlp_config": {
            "resource_attributes": {
                "ignore_defaults": True,
                "attributes_config": [
                    {"action": "index_label", "attributes": [*LABELS, "level"]},
                ],
            }
        },
        # When a cluster of robots is back, few machines send many lines at once.
        "ingestion_rate_mb": 16,
        "ingestion_burst_size_mb": 32,
        "per_stream_rate_limit": "5MB",
        "per_stream_rate_limit_burst": "20MB",
        "max_line_size_truncate": True,
    }


def _pod(stack: Stack) -> Object:
    options = stack.options.loki
    main = container(
        LOKI,
        options,
        LOKI_IMAGE,
        DEFAULTS,
        args=[f"-config.file={CONFIG}/loki.yaml"],
        env=[{"name": "GOMEMLIMIT", "valueFrom": {"resourceFieldRef": {"resource": MEMORY}}}],
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


#: The garbage collector works harder if the container's limit is near.
MEMORY = "limits.memory"
