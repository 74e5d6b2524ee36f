"""The Rigelfile of a user who comes from src.plugin: with the stack as it was asked for there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.reading.stack import find_namespace
from rigel_k8s.release.types import DeployOptions
from rigel_stack.removal import remove as remove_stack
from tests.support.recorder import Recorder

from ..conftest import inside
from .conftest import until

pytestmark = pytest.mark.cluster

EXAMPLE = Path(__file__).parents[3] / "examples" / "src-plugin" / "Rigelfile"
#: What the application runs: a publisher, and something that writes its results.
WORK = "rostopic pub -r 5 chatter std_msgs/String hello & sleep 2"
PUB = ["sh", "-c", f"{WORK}; echo 42 >/persistent/logs-volume/late; wait"]
LATE = 'source_path: "/persistent/logs-volume/late"\n          wait: 2m'


@pytest.fixture
def no_stack(cluster: Any) -> Iterator[None]:
    """Nobody has deployed a stack yet, and none is left."""
    if find_namespace(cluster):
        pytest.skip("the cluster has a stack that is not of these tests")
    yield
    if find_namespace(cluster):
        remove_stack(cluster, DeployOptions(report=Recorder()), volumes=True)


def test_the_peers_shape_deploys_and_updates(
    cluster: Any, no_stack: None, namespace: str, rigel: Any, base_image: str, tmp_path: Path
) -> None:
    """examples/src-plugin as it is, but for its images, its StorageClass and late results."""
    (default,) = (
        item["metadata"]["name"]
        for item in cluster.list("storage.k8s.io/v1", "StorageClass")
        if "true" in (item["metadata"].get("annotations") or {}).values()
    )
    text = EXAMPLE.read_text("utf-8")
    for old, new in {
        '"localhost:5000/src-plugin:1.0.0"': base_image,
        '"ros:{{ vars.distro }}-ros-core"': base_image,
        '"src-plugin"': namespace,
        '"standard"': default,
        '"maps"': f"maps-{namespace}",
        '"/usr/local/bin/readiness_probe.sh"': "test -w /persistent/logs-volume",
        "- containerPort: 8080": f"- containerPort: 8080\n{22 * ' '}args: {json.dumps(PUB)}",
        'source_path: "/persistent/logs-volume"': LATE,
    }.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "Rigelfile").write_text(text)
    volume = ObjectRef("v1", "PersistentVolume", "", f"maps-{namespace}-pv")
    try:
        rigel("run", "job", "deploy_k8s", cwd=tmp_path)
        words = ("rigel-k8s-application", "rosnode", "list")
        until(lambda: "/rosout" in inside(cluster, namespace, *words), "/rosout among the nodes")
        assert (tmp_path / "results" / "late").read_text() == "42\n"
        rigel("run", "job", "update_k8s", cwd=tmp_path)
        ref = ObjectRef("apps/v1", "Deployment", namespace, "rigel-k8s-application")
        assert cluster.get(ref)["spec"]["strategy"] == {"type": "Recreate"}
        rigel("down", "deploy_k8s", "--volumes", "-y", cwd=tmp_path)
        assert cluster.get(volume) is None
    finally:
        cluster.delete(volume)
