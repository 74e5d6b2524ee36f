"""The tutorials on a real cluster: every command, and every output that a page shows."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_lab.cluster import components
from tests.cluster.conftest import run_rigel
from tests.support.tutorials import FOLDER, RIGEL, follow, make_place

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.slow,
]  # a minute each; tests/unit/docs checks the rest


@pytest.fixture(scope="module")
def official(registry: str) -> None:
    """Images by the names that the pages have: nodes ask the cluster's registry first."""
    for tag in ("noetic", "noetic-ros-core"):
        run_rigel("image", "ros1-base", "--push", f"{registry}/library/ros:{tag}")
    run_rigel("image", "ros2-base", "--push", f"{registry}/library/ros:jazzy")


@pytest.mark.parametrize("name", ["ros1", "ros2"])
def test_a_tutorial_works_as_it_stands(
    name: str, official: None, context: str, cluster: Any, tmp_path: Path
) -> None:
    """In a namespace of another name; what changes the cluster's network is left out."""
    kubectl = str(components.obtain(print, ["kubectl"]).program("kubectl"))
    place = make_place(
        tmp_path,
        {"rigel": [*RIGEL, "--context", context], "kubectl": [kubectl, "--context", context]},
    )
    namespace = f"t-{uuid.uuid4().hex[:8]}"
    text = (FOLDER / f"{name}.md").read_text("utf-8").replace("tutorial", namespace)
    try:
        assert list(follow(text, place, cluster=True)) == []
    finally:
        cluster.delete(ObjectRef("v1", "Namespace", "", namespace))
