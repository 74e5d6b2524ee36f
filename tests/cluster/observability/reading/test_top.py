"""`rigel top` from Prometheus, from the kubelets, and for somebody who may ask nobody."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.deploy.types import ObjectRef

from .conftest import App, until

pytestmark = pytest.mark.cluster

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
        for pod in json.loads(cluster.proxied(ref, "stats/summary"))["pods"]
        if pod["podRef"]["name"] == row["pod"]
    ]
    return pod["cpu"]["usageNanoCores"] / 1e9, pod["memory"]["workingSetBytes"]


def test_top_tells_what_prometheus_knows(app: App, cluster: Any) -> None:
    """CPU and memory are the kubelet's within reason; traffic is what the nodes really send."""

    def known() -> dict[str, dict[str, Any]] | None:
        found = rows(app)
        full = all(found[name]["cpu"] for name in ("talker", "lab-listener", "ros-master"))
        return found if full and found["lab-listener"]["received"] else None

    found = until(known, "all figures")
    assert json.loads(app("top", "-o", "json").stdout)["source"] == "prometheus"
    assert set(found) == {"talker", "lab-listener", "shouter", "ros-master"}, "nodes, no exporter"
    for row in found.values():
        cores, size = kubelets_word(cluster, row)
        assert abs(row["memory"] - size) < 0.5 * size
        assert abs(row["cpu"] - cores) < 0.05 + cores
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

    def known() -> dict[str, Any] | None:
        done = app("top", "--topics", "-o", "json")
        topics = {row["name"]: row for row in json.loads(done.stdout)["topics"]}
        return topics if topics["/chatter"]["rate"] else None

    topics = until(known, "the rate of /chatter")
    chatter = topics["/chatter"]
    assert chatter["type"] == "std_msgs/String"
    assert chatter["publishers"] == 1
    assert chatter["heard"] is True
    assert chatter["age"] < 60
    until(lambda: 4 < known()["/chatter"]["rate"] < 6, "five messages a second")
    assert topics["/rosout"]["heard"] is False
    assert topics["/rosout"]["age"] is None
    assert re.search(
        r"^/chatter +std_msgs/String +1 +\d+ +[\d.]+/s", app("top", "--topics").stdout, re.M
    )
    assert "leave the names out" in app("top", "--topics", "talker", code=2).stderr


def test_without_prometheus_the_kubelets_tell(
    app: App, limited: Callable[..., App], cluster: Any
) -> None:
    """Where somebody may ask them; one line says why nobody else was asked."""
    someone = limited([NODES_PROXY])
    done = someone("top", "-o", "json")
    assert json.loads(done.stdout)["source"] == "kubelet"
    [why] = done.stderr.splitlines()
    assert why.startswith("from the kubelet: you may not ask Prometheus")
    found = rows(someone)
    for row in found.values():
        cores, size = kubelets_word(cluster, row)
        assert abs(row["memory"] - size) < 0.5 * size
        assert abs(row["cpu"] - cores) < 0.05 + cores
        assert row["up"] is None


def test_who_may_ask_nobody_is_told_so(app: App, limited: Callable[..., App]) -> None:
    """Each that was asked, and what would help."""
    error = limited()("top", code=1).stderr
    assert "nobody tells what the pods use" in error
    assert "you may not ask Prometheus" in error
    assert "you may not ask the kubelets" in error
    assert "nodes/proxy" in error
