"""`rigel top` from metrics.k8s.io or the kubelets, and what the exporter adds."""

from __future__ import annotations

import base64
import json
import re
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_lab.cluster.certificates import Authority

from .conftest import App, until

pytestmark = pytest.mark.cluster

POD_METRICS = {"apiGroups": ["metrics.k8s.io"], "resources": ["pods"], "verbs": ["get", "list"]}
#: As a metrics-server 0.9.0 wrote it.
USAGE = {"cpu": "14357308n", "memory": "33468Ki"}
NODES_PROXY = {"apiGroups": [""], "resources": ["nodes/proxy"], "verbs": ["get"]}


def rows(app: App, *words: str) -> dict[str, dict[str, Any]]:
    """Return what `top -o json` prints, by workload."""
    return {
        row["workload"]: row for row in json.loads(app("top", "-o", "json", *words).stdout)["nodes"]
    }


def kubelets_word(cluster: Any, row: dict[str, Any]) -> tuple[float, float]:
    """Return cores and bytes of a pod, as its machine's kubelet tells them."""
    ref = ObjectRef("v1", "Node", "", row["node"])
    [pod] = [
        pod
        for pod in json.loads(cluster.get_through_proxy(ref, "stats/summary"))["pods"]
        if pod["podRef"]["name"] == row["pod"]
    ]
    return pod["cpu"]["usageNanoCores"] / 1e9, pod["memory"]["workingSetBytes"]


def agrees(cluster: Any, row: dict[str, Any]) -> bool:
    """Return whether a row has what its machine's kubelet tells, within reason.

    The two are of different moments, between which a busy machine may give a pod more or less.
    """
    if row["cpu"] is None or row["memory"] is None:
        return False
    cores, size = kubelets_word(cluster, row)
    return bool(abs(row["memory"] - size) < 0.5 * size and abs(row["cpu"] - cores) < 0.05 + cores)


def test_top_tells_what_the_exporter_knows(app: App, cluster: Any) -> None:
    """CPU and memory are the kubelet's within reason; traffic is what the nodes really send."""

    def known() -> dict[str, dict[str, Any]] | None:
        found = rows(app)
        full = all(row["cpu"] and agrees(cluster, row) for row in found.values())
        seen = full and found["lab-listener"]["received"] and found["talker"]["up"]
        return found if seen else None

    found = until(known, "all figures, as the kubelets tell them")
    assert set(found) == {"talker", "lab-listener", "shouter", "ros-master"}, "nodes, no exporter"
    assert found["talker"]["up"] is True
    assert found["talker"]["ros_name"] == "/talker"
    # Five a second on /chatter, and what it logs on /rosout.
    assert until(lambda: 4 < (rows(app)["talker"]["published"] or 0) < 20, "the talker's rate")
    text = app("top", "talker").stdout
    assert re.search(
        r"^talker +/talker +yes +\d+m +\d+Mi +\d+\S* +\S+ +\d+ +talker-\S+ +\S+$", text, re.M
    )
    assert "listener" not in text


def test_topics_have_rates_and_ages(app: App) -> None:
    """A topic that is named is heard; of the others the nodes' own counts are told."""

    def known() -> dict[str, Any]:
        """The topics, once /chatter has a publisher and a rate."""
        done = app("top", "--topics", "-o", "json")
        topics = {row["name"]: row for row in json.loads(done.stdout)["topics"]}
        chatter = topics.get("/chatter", {})
        return topics if chatter.get("publishers") and chatter.get("rate") else {}

    def rate() -> float:
        return float(known().get("/chatter", {}).get("rate", 0))

    # Until the exporter's first data are in Prometheus, `top` reports that there are none.
    topics = until(known, "the rate of /chatter", despite=(AssertionError,))
    chatter = topics["/chatter"]
    assert chatter["type"] == "std_msgs/String"
    assert chatter["publishers"] == 1
    assert chatter["heard"] is True
    assert chatter["age"] < 60
    until(lambda: 4 < rate() < 6, "five messages a second")
    assert topics["/rosout"]["heard"] is False
    assert topics["/rosout"]["age"] is None
    assert re.search(
        r"^/chatter +std_msgs/String +1 +\d+ +[\d.]+/s", app("top", "--topics").stdout, re.M
    )
    assert "remove the names" in app("top", "--topics", "talker", code=2).stderr


@pytest.fixture
def metrics_api(
    app: App, cluster: Any, base_image: str, tmp_path: Path
) -> Iterator[tuple[str, ObjectRef]]:
    """metrics.k8s.io, aggregated by the API server: the talker's pod, and the server's."""
    [talker] = [row["pod"] for row in rows(app, "talker").values()]
    name, space = f"metrics-{uuid.uuid4().hex[:6]}", app.namespace
    authority = Authority(tmp_path / "authority")
    host = f"DNS:{name}.{space}.svc"
    files = authority.issue(name, name, alternatives=[host])
    texts = [file.read_text() for file in files]
    program = (Path(__file__).parent / "metrics_api.py").read_text()
    command = ["python3", "-c", program, *texts, json.dumps({talker: USAGE})]
    meta = {"name": name, "namespace": space, "labels": {"app": name}}
    container = {"name": "api", "image": base_image, "command": command}
    service = {"selector": {"app": name}, "ports": [{"port": 443, "targetPort": 8443}]}
    authorities = base64.b64encode(authority.certificate.read_bytes()).decode()
    registered = {
        "apiVersion": "apiregistration.k8s.io/v1",
        "kind": "APIService",
        "metadata": {"name": "v1beta1.metrics.k8s.io"},
        "spec": {
            **{"group": "metrics.k8s.io", "version": "v1beta1", "caBundle": authorities},
            **{"groupPriorityMinimum": 100, "versionPriority": 100},
            "service": {"name": name, "namespace": space},
        },
    }
    pod = {"apiVersion": "v1", "kind": "Pod", "metadata": meta}
    items = [
        {**pod, "spec": {"containers": [container]}},
        {"apiVersion": "v1", "kind": "Service", "metadata": meta, "spec": service},
        registered,
    ]
    for item in items:
        cluster.create(item)
    until(lambda: is_available(cluster.get(ref_of(registered))), "metrics.k8s.io is available")
    yield talker, ref_of(items[0])
    for item in reversed(items):  # unavailable APIs keep namespaces from ending
        cluster.delete(ref_of(item))


def is_available(service: dict[str, Any]) -> bool:
    """Return whether an aggregated API answers."""
    conditions = service.get("status", {}).get("conditions", [])
    return any(c["type"] == "Available" and c["status"] == "True" for c in conditions)


def test_a_metrics_server_is_asked_before_the_kubelets(
    app: App, limited: Callable[..., App], cluster: Any, metrics_api: tuple[str, ObjectRef]
) -> None:
    """With few rights, which each user of `kubectl top` has; one that is gone is left out."""
    talker, server = metrics_api
    someone = limited([POD_METRICS, NODES_PROXY])
    done = someone("top", "-o", "json", "talker")
    told = json.loads(done.stdout)
    assert told["source"] == "metrics-server"
    [row] = told["nodes"]
    assert (row["pod"], row["memory"]) == (talker, 33468 * 1024)
    assert row["cpu"] == pytest.approx(0.014357308)
    assert done.stderr == ""
    cluster.delete(server)

    def source() -> str:
        return str(json.loads(someone("top", "-o", "json", "talker").stdout)["source"])

    until(lambda: source() == "kubelet", "its end")
