"""Grafana with provisioned datasources and dashboards; its administrator is in a Secret."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.manifests.dashboards import DIRECTORY, config_name, dashboards
from rigel_k8s.observability.manifests.frame import (
    Object,
    container,
    data_volume,
    http_probes,
    load,
    mount,
    read_file,
)
from rigel_k8s.observability.manifests.images import GRAFANA_IMAGE
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import GRAFANA, GRAFANA_PORT

#: The Secret with the administrator, and its keys.
ADMIN_SECRET, USER_NAME, PASSWORD = "grafana-admin", "admin-user", "admin-password"
SIZE = "1Gi"
USER = 472
PROVISIONING = "/etc/grafana/provisioning"
DATA = "/var/lib/grafana"
DEFAULTS = {
    "requests": {"cpu": "50m", "memory": "128Mi"},
    "limits": {"memory": "512Mi"},
}
REMEDY = (
    "its image is large; if the machines cannot pull it, set grafana.image to one in a registry of"
    " your own, or grafana: {enabled: false}"
)
SETTINGS = {
    "GF_PATHS_PROVISIONING": PROVISIONING,
    "GF_LOG_MODE": "console",
    "GF_LOG_LEVEL": "warn",
    "GF_USERS_ALLOW_SIGN_UP": "false",
    # A robot's network may have no Internet: request nothing from it.
    "GF_ANALYTICS_REPORTING_ENABLED": "false",
    "GF_ANALYTICS_CHECK_FOR_UPDATES": "false",
    "GF_ANALYTICS_CHECK_FOR_PLUGIN_UPDATES": "false",
    "GF_NEWS_NEWS_FEED_ENABLED": "false",
    "GF_PLUGINS_PREINSTALL_DISABLED": "true",
    "GF_SECURITY_DISABLE_GRAVATAR": "true",
}


def grafana(stack: Stack) -> Iterator[Object]:
    """Yield Grafana's objects, without its Secret."""
    frame, options = stack.frame, stack.options.grafana
    texts = {
        "datasources.yaml": _datasources(stack),
        "dashboards.yaml": read_file("dashboards.yaml"),
    }
    config = frame.config_map(GRAFANA, texts, GRAFANA)
    yield frame.account(GRAFANA)
    yield config
    yield from dashboards(stack)
    if stack.keeps(options.persistence, default=False):
        yield frame.claim(GRAFANA, options.persistence, SIZE)
    yield frame.service(GRAFANA, GRAFANA_PORT, options.service_type)
    # Its image is large, and robots must not wait for dashboards.
    yield frame.deployment(GRAFANA, _pod(stack), [config], remedy=REMEDY)


def _datasources(stack: Stack) -> str:
    """Return the datasources that have an address."""
    known = load("datasources.yaml")
    prometheus = known["prometheus"] | {"url": stack.prometheus_url}
    interval = str(stack.options.prometheus.scrape_interval or "15s")
    prometheus["jsonData"]["timeInterval"] = interval
    loki = known["loki"] | {"url": stack.loki_url}
    existing = stack.other_loki
    if existing and existing.tenant:
        loki["jsonData"]["httpHeaderName1"] = "X-Scope-OrgID"
        loki["secureJsonData"] = {"httpHeaderValue1": existing.tenant}
    if existing and existing.secret:
        loki |= {"basicAuth": True, "basicAuthUser": "$LOKI_USER"}
        loki.setdefault("secureJsonData", {})["basicAuthPassword"] = "$LOKI_PASSWORD"
    sources = [source for source in (prometheus, loki) if source["url"]]
    return yaml.safe_dump({"apiVersion": 1, "datasources": sources}, sort_keys=False)


def _pod(stack: Stack) -> Object:
    options = stack.options.grafana
    names = sorted(stack.boards.dashboards) if options.default_dashboards else []
    shown = [
        {"configMap": {"name": config_name(name), "items": [{"key": name, "path": name}]}}
        for name in names
    ]
    main = container(
        GRAFANA,
        options,
        GRAFANA_IMAGE,
        DEFAULTS,
        env=[
            *({"name": name, "value": value} for name, value in SETTINGS.items()),
            _secret("GF_SECURITY_ADMIN_USER", ADMIN_SECRET, USER_NAME),
            _secret("GF_SECURITY_ADMIN_PASSWORD", ADMIN_SECRET, PASSWORD),
            *_loki_user(stack),
        ],
        ports=[{"name": "http", "containerPort": GRAFANA_PORT}],
        volumeMounts=[
            {**mount("config", f"{PROVISIONING}/{kind}/{kind}.yaml", read_only=True)}
            | {"subPath": f"{kind}.yaml"}
            for kind in ("datasources", "dashboards")
        ]
        + [
            mount("dashboards", DIRECTORY, read_only=True),
            mount("data", DATA),
            mount("tmp", "/tmp"),
        ],
        **http_probes("/api/health"),
    )
    return {
        "serviceAccountName": GRAFANA,
        "securityContext": pod_context(USER),
        "containers": [main],
        "volumes": [
            {"name": "config", "configMap": {"name": GRAFANA}},
            {"name": "dashboards", "projected": {"sources": shown}},
            data_volume(GRAFANA, kept=stack.keeps(options.persistence, default=False)),
            {"name": "tmp", "emptyDir": {}},
        ],
    }


def _loki_user(stack: Stack) -> list[Object]:
    """Return the variables with the user of a Loki that needs a login."""
    secret = stack.other_loki.secret if stack.other_loki else None
    if not secret:
        return []
    return [
        _secret("LOKI_USER", secret, "username"),
        _secret("LOKI_PASSWORD", secret, "password"),
    ]


def _secret(variable: str, name: str, key: str) -> Object:
    return {"name": variable, "valueFrom": {"secretKeyRef": {"name": str(name), "key": key}}}
