"""`rigel observe`: the stack at ports of this machine, until Ctrl-C."""

from __future__ import annotations

import json
import socket
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ObjectRef

from ...background import Background
from ..conftest import is_ready
from .conftest import App, until

pytestmark = pytest.mark.cluster

#: What stands in for Grafana, whose image cannot be had everywhere: a page at its port.
PAGE = "mkdir -p /tmp/w && echo here > /tmp/w/index.html && exec httpd -f -p 3000 -h /tmp/w"


def answer(url: str) -> str | None:
    """Return what an address answers, None where it does not."""
    try:
        with urllib.request.urlopen(url, timeout=10) as opened:
            text: str = opened.read().decode()
            return text
    except (OSError, urllib.error.URLError):
        return None


def in_namespace(app: App, namespace: str, *words: str) -> list[str]:
    """Return the words of a command about the stack of a namespace."""
    command = app.command(*words)
    return [namespace if word == app.namespace else word for word in command]


def opened(running: Background) -> dict[str, Any]:
    """Return what `observe -o json` prints first."""
    until(lambda: "}" in running.lines, "the addresses")
    text = "\n".join(running.lines)
    found: dict[str, Any] = json.loads(text[: text.rindex("}") + 1])
    return found


def test_the_addresses_answer_until_ctrl_c(
    app: App, stack: str, start: Callable[..., Background]
) -> None:
    """Prometheus and Loki are there as if they ran here; nothing is left behind."""
    running = start(in_namespace(app, stack, "observe", "-o", "json", "--loki", "0"))
    urls = opened(running)["urls"]
    until(lambda: answer(f"{urls['prometheus']}/-/ready"), "Prometheus")
    assert json.loads(answer(f"{urls['prometheus']}/api/v1/query?query=up") or "")["data"]["result"]
    until(lambda: answer(f"{urls['loki']}/ready") == "ready\n", "Loki")
    assert running.interrupt() == 130
    for url in urls.values():
        with (
            pytest.raises(ConnectionRefusedError),
            socket.create_connection(("127.0.0.1", port(url)), timeout=5),
        ):
            pass


def port(url: str) -> int:
    """Return an address' port."""
    return int(url.rpartition(":")[2])


def test_status_says_what_it_hears(app: App, stack: str) -> None:
    """Workloads, whether each part answers, whose lines came lately, and alerts."""
    there = App(app.file, app.context, stack)

    def hears() -> dict[str, Any] | None:
        found: dict[str, Any] = json.loads(there("observe", "status", "-o", "json").stdout)
        said = {one["name"]: one["said"] for one in found["answers"]}
        return found if "rigel-k8s-application" in said["loki"] else None

    found = until(hears, "lines of an application")
    assert {one["name"] for one in found["answers"] if one["ok"]} >= {"loki", "prometheus"}
    assert "targets" in there("observe", "status").stdout
    assert isinstance(found["alerts"], list)


GRAFANA = {"name": "grafana", "labels": {"app.kubernetes.io/name": "grafana"}}
GRAFANA["labels"]["rigel-k8s/release"] = "rigel-observability"


def grafana_pod(registry: str) -> dict[str, Any]:
    """Return the pod that stands in for Grafana."""
    container = {
        "name": "grafana",
        "image": f"{registry}/rigel-k8s/busybox:1",
        "command": ["sh", "-c", PAGE],
        "ports": [{"name": "http", "containerPort": 3000}],
        "readinessProbe": {"httpGet": {"path": "/", "port": "http"}, "periodSeconds": 1},
    }
    spec = {"containers": [container], "terminationGracePeriodSeconds": 0}
    return {"kind": "Pod", "metadata": GRAFANA, "spec": spec}


@pytest.fixture
def grafana(cluster: Any, namespace: str, registry: str) -> Iterator[str]:
    """A namespace with what stands in for Grafana, and its Secret."""
    login = {"admin-user": "admin", "admin-password": "s3cret"}
    ports = [{"name": "http", "port": 3000, "targetPort": "http"}]
    service = {"selector": {"app.kubernetes.io/name": "grafana"}, "ports": ports}
    for manifest in (
        {"kind": "Secret", "metadata": {"name": "grafana-admin"}, "stringData": login},
        grafana_pod(registry),
        {"kind": "Service", "metadata": GRAFANA, "spec": service},
    ):
        create(cluster, namespace, manifest)
    until(lambda: is_ready(cluster.get(ObjectRef("v1", "Pod", namespace, "grafana"))), "the pod")
    yield namespace
    cluster.delete(ObjectRef("v1", "Service", namespace, "grafana"))


def create(cluster: Any, namespace: str, manifest: dict[str, Any]) -> None:
    """Create an object, as soon as its namespace has the account that pods run as."""
    meta = {**manifest["metadata"], "namespace": namespace}

    def made() -> bool:
        try:
            return bool(cluster.create({"apiVersion": "v1", **manifest, "metadata": meta}))
        except ClusterError as error:
            if "serviceaccount" not in error.message:
                raise
            return False

    until(made, "the namespace's account")


def test_grafanas_password_is_shown_unless_told(
    app: App, grafana: str, start: Callable[..., Background]
) -> None:
    """It is the Secret's; whoever shows the screen to others says --no-password."""
    running = start(in_namespace(app, grafana, "observe", "--grafana", "0"))
    pattern = r"Grafana +(http://\S+) +user admin, password s3cret"
    found = until(lambda: running.found(pattern), "the address")
    assert until(lambda: answer(found[1]), "the page") == "here\n"
    hidden = start(in_namespace(app, grafana, "observe", "--grafana", "0", "--no-password"))
    until(lambda: hidden.found(r"Grafana +http"), "the address")
    assert not hidden.found("s3cret")
