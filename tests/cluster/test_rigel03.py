"""Rigel 0.3 itself deploys real ROS nodes with our plugin."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef

pytestmark = pytest.mark.cluster

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros1-talker-listener" / "talker_listener"
RIGEL03 = os.environ.get("RIGEL03_PYTHON", "")

RIGELFILE = """\
vars:
  image: BASE_IMAGE
application: {distro: noetic}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: SPACE
      ros_master_image: "{{ vars.image }}"
      image: "{{ vars.image | replace('x', 'x') }}"
      nodes:
        talker:
          args: [python3, /nodes/talker.py]
          volumes: [{config_map: nodes, mount_path: /nodes}]
        listener:
          args: [python3, /nodes/listener.py]
          volumes: [{config_map: nodes, mount_path: /nodes}]
          placement: {apart_from: [talker]}
sequences:
  all: {stages: [{jobs: [deploy]}]}
"""


@pytest.fixture(scope="module")
def space(cluster: Any) -> Iterator[str]:
    """A namespace for all tests of this file, with the example's nodes in a ConfigMap."""
    name = "t-rigel03"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    nodes = {file.name: file.read_text() for file in EXAMPLE.rglob("*.py")}
    meta = {"name": "nodes", "namespace": name}
    cluster.create({"apiVersion": "v1", "kind": "ConfigMap", "metadata": meta, "data": nodes})
    yield name
    cluster.delete(ObjectRef("v1", "Namespace", "", name))


@pytest.fixture
def project(tmp_path: Path, space: str, base_image: str) -> Path:
    """A directory with the Rigelfile."""
    text = RIGELFILE.replace("SPACE", space).replace("BASE_IMAGE", base_image)
    (tmp_path / "Rigelfile").write_text(text)
    return tmp_path


@pytest.mark.skipif(not RIGEL03, reason="RIGEL03_PYTHON names no environment with Rigel 0.3")
def test_rigel_itself_deploys(
    project: Path, space: str, context: str, tmp_path: Path, cluster: Any
) -> None:
    """`rigel run sequence` of Rigel 0.3, with our plugins, from the same Rigelfile."""
    known = os.environ.get("KUBECONFIG") or str(Path.home() / ".kube" / "config")
    config = yaml.safe_load(Path(known.split(os.pathsep)[0]).read_text())
    config["current-context"] = context
    (tmp_path / "kubeconfig").write_text(yaml.safe_dump(config))
    done = subprocess.run(
        [RIGEL03, "-m", "rigel.main", "run", "sequence", "all"],
        cwd=project,
        env={**os.environ, "KUBECONFIG": str(tmp_path / "kubeconfig")},
        capture_output=True,
        text=True,
        check=False,
        timeout=400,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    names = {one["metadata"]["name"] for one in cluster.list("apps/v1", "Deployment", space)}
    assert names == {"ros-master", "talker", "listener"}
