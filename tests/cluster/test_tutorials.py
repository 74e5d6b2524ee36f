"""The tutorials on a real cluster: every command, and every output that a page shows."""

from __future__ import annotations

import re
import uuid
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_lab.cluster import components
from tests.cluster.conftest import run_rigel
from tests.support.ros2base import push_ros2
from tests.support.tutorials import FOLDER, RIGEL, follow, make_place, run

from .machines import own_cluster

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.slow,
]  # a minute each; tests/unit/docs checks the rest


#: Figures that a page shows as an example.
FIGURES = re.compile(r"^```text\nNODE .*?^```\n", re.M | re.S)
DELETION = "```shell\nkubectl -n tutorial delete pod"
#: Until Loki has the listener's lines; a reader has seen them in Grafana by then.
LINES = (
    "for _ in {1..60}; do rigel logs --since 10m listener 2>&1 | grep -q hello && break;"
    " sleep 2; done"
)
#: Until the listener has heard enough; a reader is not as quick.
HEARD = (
    "for _ in {1..60}; do [ $(rigel logs listener 2>&1 | grep -c hello) -gt 4 ] && break;"
    " sleep 1; done"
)
#: Why a page may be wrong: the state of the stack, which its last commands remove.
STATE = (
    "rigel observe status || true; kubectl -n monitoring get pods -o wide || true;"
    " kubectl -n monitoring logs daemonset/otel-collector --tail 30"
)


@pytest.fixture(scope="module")
def official(registry: str) -> None:
    """Images by the names that the pages have: nodes ask the cluster's registry first."""
    push_ros1(registry)
    push_ros2(f"{registry}/library/ros:jazzy")


def push_ros1(registry: str) -> None:
    """Push the base image of ROS 1 by its official names."""
    for tag in ("noetic", "noetic-ros-core"):
        run_rigel("image", "ros1-base", "--push", f"{registry}/library/ros:{tag}")


def make_clusters_place(directory: Path, context: str) -> Path:
    """Return a directory with a `rigel` and a `kubectl` for a cluster."""
    kubectl = str(components.obtain(print, ["kubectl"]).program("kubectl"))
    rigel = [*RIGEL, "--context", context]
    return make_place(directory, {"rigel": rigel, "kubectl": [kubectl, "--context", context]})


@pytest.mark.parametrize("name", ["ros1", "ros2"])
def test_a_tutorial_works_as_it_stands(
    name: str, official: None, context: str, cluster: Any, tmp_path: Path
) -> None:
    """In a namespace of another name; what changes the cluster's network is left out."""
    place = make_clusters_place(tmp_path, context)
    namespace = f"t-{uuid.uuid4().hex[:8]}"
    text = (FOLDER / f"{name}.md").read_text("utf-8").replace("tutorial", namespace)
    text = text.replace("rigel logs listener --tail 4", f"{HEARD}\nrigel logs listener --tail 4")
    # Whether the graph has seen a rate of two nodes of one name is chance.
    text = text.replace("std_msgs/msg/String  -  ", "std_msgs/msg/String  ...")
    try:
        assert list(follow(text, place, cluster=True)) == []
    finally:
        cluster.delete(ObjectRef("v1", "Namespace", "", namespace))


def test_the_tutorial_of_the_stack_works_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a cluster of its own, since it removes the stack. Grafana's image cannot be had here."""
    monkeypatch.setenv("KUBECONFIG", str(tmp_path / "kubeconfig"))
    text = FIGURES.sub("", (FOLDER / "observability.md").read_text("utf-8"))
    text, changed = re.subn(
        r"^( +)enabled: true$", r"\g<0>\n\1grafana: { enabled: false }", text, flags=re.M
    )
    assert changed == 1
    text = text.replace("```shell\nrigel top\n", "```shell\nsleep 60\nrigel top\n")
    assert DELETION in text
    text = text.replace(DELETION, DELETION.replace("\n", f"\n{LINES}\n"))
    extras = ["observability", "kubectl"]
    with own_cluster("test-watch", nodes=2, extras=extras) as (name, registry):
        push_ros1(registry)
        place = make_clusters_place(tmp_path, f"rigel-{name}")
        for wrong in follow(text, place, cluster=True):
            pytest.fail(f"{wrong}\n{run(STATE, place).stdout}")
