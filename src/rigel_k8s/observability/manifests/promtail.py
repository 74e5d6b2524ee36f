"""Promtail on every machine: it reads the lines of that machine's pods.

It runs as root, since only root may read them, but without root's capabilities.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import yaml

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.observability.manifests import lines
from rigel_k8s.observability.manifests.frame import (
    Object,
    container,
    http_probes,
    mount,
    rule,
)
from rigel_k8s.observability.manifests.images import PROMTAIL_IMAGE
from rigel_k8s.observability.manifests.relabelling import contract, rules
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import LABELS

PROMTAIL, PROMTAIL_PORT = "promtail", 9080
CONFIG = "/etc/promtail"
SECRET = "/etc/promtail-loki"
LOGS = "/var/log/pods"
#: How far each file was read, kept on the machine: the next pod continues where this one stops.
#: Machines may share a disk, so the file's name contains the machine's.
POSITIONS = "/var/lib/rigel-promtail"
DEFAULTS = {
    "requests": {"cpu": "25m", "memory": "64Mi"},
    "limits": {"memory": "256Mi"},
}


def promtail(stack: Stack) -> Iterator[Object]:
    """Yield Promtail's objects."""
    frame = stack.frame
    config = frame.config_map(PROMTAIL, {"promtail.yaml": configuration(stack)}, PROMTAIL)
    yield frame.account(PROMTAIL)
    yield from frame.rights(PROMTAIL, [rule("", ["pods"], ["get", "list", "watch"])])
    yield config
    yield frame.daemon_set(PROMTAIL, _pod(stack), [config])


def configuration(stack: Stack) -> str:
    """Return promtail.yaml."""
    made: Object = {
        "server": {"http_listen_port": PROMTAIL_PORT, "grpc_listen_port": 0, "log_level": "warn"},
        "positions": {"sync_period": "2s"},
        "clients": [_client(stack)],
        # A file without new lines is checked again soon.
        "target_config": {"sync_period": "5s"},
        "scrape_configs": [_scrape(stack)],
    }
    return yaml.safe_dump(made, sort_keys=False, width=100_000)


def _client(stack: Stack) -> Object:
    """Return where lines go; while it does not answer, they wait, and none is dropped."""
    made: Object = {
        "url": f"{stack.loki_url}/loki/api/v1/push",
        "backoff_config": {"min_period": "500ms", "max_period": "5s", "max_retries": 0},
    }
    loki = stack.other_loki
    if loki and loki.tenant:
        made["tenant_id"] = loki.tenant
    if loki and loki.secret:
        made["basic_auth"] = {
            "username_file": f"{SECRET}/username",
            "password_file": f"{SECRET}/password",
        }
    return made


def _scrape(stack: Stack) -> Object:
    # Promtail itself adds the machine to the selector, by HOSTNAME, so it only sees its own pods.
    found: Object = {"role": "pod"}
    if stack.options.collect != "all":
        found["selectors"] = [{"role": "pod", "label": RELEASE_LABEL}]
    return {
        "job_name": "pods",
        "kubernetes_sd_configs": [found],
        "relabel_configs": [*contract(), *rules("log_path")],
        "pipeline_stages": list(_stages()),
    }


def _stages() -> Iterator[dict[str, Any]]:
    yield {"cri": {}}
    yield {"replace": {"expression": lines.GOES_ON, "replace": lines.MARKED}}
    yield {
        "multiline": {
            "firstline": lines.FIRST_LINE,
            "max_wait_time": lines.WAIT,
            "max_lines": lines.LONGEST,
        }
    }
    yield {"replace": {"expression": f"({lines.MARK})", "replace": ""}}
    for form in (*lines.LEVEL_FORMS, lines.TRACEBACK):
        yield {"regex": {"expression": form}}
    yield {"template": {"source": "level", "template": lines.LEVEL_TEMPLATE}}
    yield {"labels": {"level": None}}
    yield {"labelallow": [*LABELS, "level"]}


def _pod(stack: Stack) -> Object:
    loki = stack.other_loki
    secret = loki.secret if loki else None
    read = [("config", CONFIG), ("logs", LOGS)] + ([("loki", SECRET)] if secret else [])
    volumes: list[Object] = [
        {"name": "config", "configMap": {"name": PROMTAIL}},
        {"name": "logs", "hostPath": {"path": LOGS, "type": "DirectoryOrCreate"}},
        {"name": "positions", "hostPath": {"path": POSITIONS, "type": "DirectoryOrCreate"}},
    ]
    if secret:
        volumes.append({"name": "loki", "secret": {"secretName": str(secret)}})
    main = container(
        PROMTAIL,
        stack.options.promtail,
        PROMTAIL_IMAGE,
        DEFAULTS,
        args=[
            f"-config.file={CONFIG}/promtail.yaml",
            f"-positions.file={POSITIONS}/$(HOSTNAME).yaml",
        ],
        env=[{"name": "HOSTNAME", "valueFrom": {"fieldRef": {"fieldPath": "spec.nodeName"}}}],
        ports=[{"name": "http", "containerPort": PROMTAIL_PORT}],
        volumeMounts=[
            *(mount(name, path, read_only=True) for name, path in read),
            mount("positions", POSITIONS),
        ],
        **http_probes("/ready"),
    )
    return {
        "serviceAccountName": PROMTAIL,
        "automountServiceAccountToken": True,
        # If Loki restarts too, Promtail waits for it with the lines that it has read.
        "terminationGracePeriodSeconds": 120,
        "securityContext": {"runAsUser": 0, "seccompProfile": {"type": "RuntimeDefault"}},
        "containers": [main],
        "volumes": volumes,
    }
