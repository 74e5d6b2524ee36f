"""The options that docs/multus.md and docs/k3s.md show are right, and what they name is pinned."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from rigel_multus.installation import MULTUS_IMAGE, PLUGINS_IMAGE, WHEREABOUTS_IMAGE
from rigel_multus.platform import platform

from ..app.shapes import problems, release

DOCS = Path(__file__).parents[3] / "docs"
MULTUS = (DOCS / "multus.md").read_text("utf-8")


def block(name: str) -> dict[str, object]:
    """Return a document's YAML block."""
    (text,) = re.findall(r"^```yaml\n(.*?)^```", (DOCS / name).read_text("utf-8"), re.M | re.S)
    return dict(yaml.safe_load(text))


def test_options_of_the_manual() -> None:
    """They pass the check and become objects."""
    text = yaml.safe_dump(block("multus.md"))
    assert problems(text, "jazzy") == []
    assert release(text, distro="jazzy").objects


def test_rigelfile_of_the_guide() -> None:
    """Its job passes the check; tests/cluster runs it."""
    rigelfile: dict[str, dict[str, dict[str, object]]] = block("k3s.md")  # type: ignore[assignment]
    text = yaml.safe_dump(rigelfile["jobs"]["deploy"]["with"])
    assert problems(text, "jazzy") == []


def test_nodes_of_the_guide_are_not_missing() -> None:
    """No ROS name is expected of `ros2 topic`, which chooses the name of its node."""
    rigelfile: dict[str, dict[str, dict[str, object]]] = block("k3s.md")  # type: ignore[assignment]
    made = release(yaml.safe_dump(rigelfile["jobs"]["deploy"]["with"]), distro="jazzy")
    pods = [one["spec"]["template"] for one in made.objects if one["kind"] == "Deployment"]
    lines = [pod["spec"]["containers"][0].get("args", []) for pod in pods]
    talking = [pod for pod, line in zip(pods, lines, strict=True) if line[2:4] == ["ros2", "topic"]]
    assert len(talking) == 2
    assert not any("rigel-k8s/ros-name" in pod["metadata"]["annotations"] for pod in talking)


@pytest.mark.parametrize("image", [MULTUS_IMAGE, WHEREABOUTS_IMAGE, PLUGINS_IMAGE])
def test_images_of_the_manual(image: str) -> None:
    """Who brings images to machines without internet brings those that are used."""
    assert f"`{image}`" in MULTUS


@pytest.mark.parametrize("kind", ["microk8s", "kind", "minikube", "plain"])
def test_directories_of_the_manual(kind: str) -> None:
    """The table of directories is that of the code."""
    where = platform(kind)  # type: ignore[arg-type]
    rows = [line for line in MULTUS.lower().splitlines() if line.startswith(f"| {kind} | ")]
    assert f"`{where.conf_dir}` | `{where.bin_dir}` |" in rows[-1]
