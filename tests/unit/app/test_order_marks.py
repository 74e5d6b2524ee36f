"""The marks by which a deploy knows what comes first and what may be there only once."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.marks import FIRST_ANNOTATION, SINGLETON_ANNOTATION

from .shapes import find, release

NODES = """
image: lab/app:1
nodes:
  talker: {args: talk}
  crowd: {args: talk, anonymous: true}
"""


def notes(name: str, distro: str = "noetic") -> dict[str, Any]:
    """Return the annotations of a Deployment."""
    meta = find(release(NODES, distro=distro), "Deployment", name)["metadata"]
    return dict(meta.get("annotations") or {})


def test_a_master_is_ready_before_its_nodes() -> None:
    assert notes("ros-master")[FIRST_ANNOTATION] == "true"
    assert FIRST_ANNOTATION not in notes("talker")


@pytest.mark.parametrize("distro", ["noetic", "jazzy"])
def test_a_ros_name_is_there_only_once(distro: str) -> None:
    """A second node of the name ends the first; one that makes its name up meets nobody."""
    assert notes("talker", distro)[SINGLETON_ANNOTATION] == "/talker"
    assert SINGLETON_ANNOTATION not in notes("crowd", distro)
