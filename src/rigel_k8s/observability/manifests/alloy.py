"""Grafana Alloy, Promtail's successor: one pod that reads all pods' lines from the API server.

It needs neither root nor the machines' directories, so it works with any container runtime. Every
line passes the API server.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from string import Template

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.manifests import lines
from rigel_k8s.observability.manifests.frame import (
    Object,
    container,
    data_volume,
    http_probes,
    mount,
    read_file,
    rule,
)
from rigel_k8s.observability.manifests.images import ALLOY_IMAGE
from rigel_k8s.observability.manifests.relabelling import contract
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import LABELS
from rigel_k8s.observability.options import Persistence

ALLOY, ALLOY_PORT = "alloy", 12345
CONFIG, DATA, SECRET = "/etc/alloy", "/var/lib/alloy/data", "/etc/alloy-loki"
SIZE = "1Gi"
USER = 473
DEFAULTS = {
    "requests": {"cpu": "50m", "memory": "128Mi"},
    "limits": {"memory": "512Mi"},
}


def alloy(stack: Stack) -> Iterator[Object]:
    """Yield Alloy's objects; its claim keeps how far it has read."""
    frame = stack.frame
    config = frame.config_map(ALLOY, {"config.alloy": configuration(stack)}, ALLOY)
    yield frame.account(ALLOY)
    yield from frame.rights(
        ALLOY,
        [rule("", ["pods"], ["get", "list", "watch"]), rule("", ["pods/log"], ["get"])],
    )
    yield config
    if stack.claims:
        yield frame.claim(ALLOY, Persistence(), SIZE)
    yield frame.deployment(ALLOY, _pod(stack), [config])


def configuration(stack: Stack) -> str:
    """Return config.alloy: find pods, label them, read, join, level and send their lines.

    Its values are texts, numbers and lists as in JSON. A line waits for weeks while Loki does not
    answer.
    """
    forms = (*lines.LEVEL_FORMS, lines.TRACEBACK)
    values = {
        "goes_on": lines.GOES_ON,
        "marked": lines.MARKED,
        "first_line": lines.FIRST_LINE,
        "wait": lines.WAIT,
        "longest": lines.LONGEST,
        "mark": f"({lines.MARK})",
        "level": lines.LEVEL_TEMPLATE,
        "labels": [*LABELS, "level"],
        "url": f"{stack.loki_url}/loki/api/v1/push",
    }
    chosen = block("selectors", 1, role='"pod"', label=json.dumps(RELEASE_LABEL))
    text = Template(read_file("config.alloy")).substitute(
        {name: json.dumps(value) for name, value in values.items()},
        selectors="" if stack.options.collect == "all" else chosen,
        rules="".join(
            block("rule", 1, **{key: json.dumps(value) for key, value in one.items()})
            for one in contract()
        ),
        forms="".join(block("stage.regex", 1, expression=json.dumps(form)) for form in forms),
        login=_login(stack),
    )
    return text.rstrip("\n")


def block(kind: str, depth: int, **values: str) -> str:
    """Return a block of Alloy's language, with an end of line before it."""
    end = "\n" + "  " * depth
    return "".join([end, kind, " {", *(f"{end}  {k} = {v}" for k, v in values.items()), end, "}"])


def _login(stack: Stack) -> str:
    loki, text = stack.other_loki, ""
    if loki and loki.tenant:
        text += f"\n    tenant_id = {json.dumps(loki.tenant)}"
    if loki and loki.secret:
        # Its language cannot read a user's name from a file, so it is in the environment.
        password = json.dumps(f"{SECRET}/password")
        text += block("basic_auth", 2, username='sys.env("LOKI_USER")', password_file=password)
    return text


def _pod(stack: Stack) -> Object:
    loki = stack.other_loki
    secret = str(loki.secret) if loki and loki.secret else None
    user = {"secretKeyRef": {"name": secret, "key": "username"}}
    main = container(
        ALLOY,
        stack.options.alloy,
        ALLOY_IMAGE,
        DEFAULTS,
        args=[
            "run",
            f"{CONFIG}/config.alloy",
            f"--storage.path={DATA}",
            f"--server.http.listen-addr=0.0.0.0:{ALLOY_PORT}",
            "--disable-reporting",
        ],
        **({"env": [{"name": "LOKI_USER", "valueFrom": user}]} if secret else {}),
        ports=[{"name": "http", "containerPort": ALLOY_PORT}],
        volumeMounts=[
            mount("config", CONFIG, read_only=True),
            mount("data", DATA),
            *([mount("loki", SECRET, read_only=True)] if secret else []),
        ],
        **http_probes("/-/ready"),
    )
    volumes: list[Object] = [
        {"name": "config", "configMap": {"name": ALLOY}},
        data_volume(ALLOY, kept=stack.claims),
    ]
    if secret:
        volumes.append({"name": "loki", "secret": {"secretName": secret}})
    return {
        "serviceAccountName": ALLOY,
        "automountServiceAccountToken": True,
        "securityContext": pod_context(USER),
        "terminationGracePeriodSeconds": 120,
        "containers": [main],
        "volumes": volumes,
    }
