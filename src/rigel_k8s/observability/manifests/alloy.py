"""Grafana Alloy, Promtail's successor: one pod that reads all pods' lines from the API server.

It needs neither root nor the machines' directories, so it works with any container runtime. Every
line passes the API server.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.manifests import lines
from rigel_k8s.observability.manifests.frame import (
    Object,
    container,
    data_volume,
    http_probes,
    mount,
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
#: So that lines wait for weeks while Loki does not answer.
RETRIES = 1_000_000


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
    """Return config.alloy: find pods, label them, read, join, level and send their lines."""
    chosen = block("selectors", {"role": "pod", "label": RELEASE_LABEL})
    selectors = [] if stack.options.collect == "all" else [chosen]
    return "\n\n".join(
        [
            block("logging", {"level": "warn"}),
            block("discovery.kubernetes", {"role": "pod"}, "pods", selectors),
            block(
                "discovery.relabel",
                {"targets": Name("discovery.kubernetes.pods.targets")},
                "pods",
                [block("rule", one) for one in contract()],
            ),
            block(
                "loki.source.kubernetes",
                {
                    "targets": Name("discovery.relabel.pods.output"),
                    "forward_to": [Name("loki.process.pods.receiver")],
                },
                "pods",
            ),
            block(
                "loki.process",
                {"forward_to": [Name("loki.write.loki.receiver")]},
                "pods",
                list(_stages()),
            ),
            block("loki.write", {}, "loki", [_endpoint(stack)]),
        ]
    )


class Name(str):
    """A name in Alloy's language, which is written without quotes."""


def block(
    kind: str, values: Mapping[str, object], label: str = "", inner: Sequence[str] = ()
) -> str:
    """Return a block of Alloy's language."""
    head = f'{kind} "{label}"' if label else kind
    body = [f"{key} = {render_literal(value)}" for key, value in values.items()] + list(inner)
    text = "\n".join(body).replace("\n", "\n  ")
    return f"{head} {{\n  {text}\n}}" if body else f"{head} {{ }}"


def render_literal(value: object) -> str:
    """Return a value in Alloy's language: JSON, except for names and the `=` in objects."""
    if isinstance(value, Name):
        return str(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {render_literal(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(render_literal(item) for item in value) + "]"
    return json.dumps(value)


def _stages() -> Iterator[str]:
    yield block("stage.replace", {"expression": lines.GOES_ON, "replace": lines.MARKED})
    yield block(
        "stage.multiline",
        {
            "firstline": lines.FIRST_LINE,
            "max_wait_time": lines.WAIT,
            "max_lines": lines.LONGEST,
        },
    )
    yield block("stage.replace", {"expression": f"({lines.MARK})", "replace": ""})
    for form in (*lines.LEVEL_FORMS, lines.TRACEBACK):
        yield block("stage.regex", {"expression": form})
    yield block("stage.template", {"source": "level", "template": lines.LEVEL_TEMPLATE})
    yield block("stage.labels", {"values": {"level": ""}})
    yield block("stage.label_keep", {"values": [*LABELS, "level"]})


def _endpoint(stack: Stack) -> str:
    loki = stack.other_loki
    values: dict[str, object] = {
        "url": f"{stack.loki_url}/loki/api/v1/push",
        "max_backoff_period": "5s",
        "max_backoff_retries": RETRIES,
    }
    inner = []
    if loki and loki.tenant:
        values["tenant_id"] = loki.tenant
    if loki and loki.secret:
        # Its language cannot read a user's name from a file, so it is in the environment.
        user = {"username": Name('sys.env("LOKI_USER")'), "password_file": f"{SECRET}/password"}
        inner.append(block("basic_auth", user))
    return block("endpoint", values, inner=inner)


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
