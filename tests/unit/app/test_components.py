"""What a node's components change: names, its own pod, and who is looked for in the graph."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_k8s.app.generations.ros1.commands import resolve
from rigel_k8s.app.parts import Parts
from rigel_k8s.generation import GENERATIONS, Texts
from rigel_k8s.objects.workloads import ReleaseContext

from .shapes import find, options, release

TWO = """
image: robot:1
nodes:
  eyes: {{ components: {{ left: {{ plugin: car/Eye, parameters: {{ rate: {} }} }} }} }}
  ears: {{ components: {{ right: {{ plugin: car/Ear }} }} }}
"""


def template(text: str, name: str) -> dict[str, Any]:
    """Return a Deployment's pod template."""
    made: dict[str, Any] = find(release(text), "Deployment", name)["spec"]["template"]
    return made


def test_a_changed_component_replaces_its_own_pod_only() -> None:
    """The manager and its nodelets are one pod; nothing else is started again."""
    before, after = TWO.format(1), TWO.format(2)
    assert template(before, "eyes") != template(after, "eyes")
    for name in ("ears", "ros-master"):
        assert template(before, name) == template(after, name)


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("image", "/robot/image"),
        ("/image", "/image"),
        ("~image", "/robot/eye/image"),
        ("~/image", "/robot/eye/image"),
    ],
)
def test_names_of_a_nodelet_are_those_of_its_namespace(name: str, full: str) -> None:
    """As ROS resolves them for a node."""
    assert resolve(name, "/robot/eye", "/robot") == full


def test_a_nodelet_at_the_root_has_names_of_the_root() -> None:
    text = "{image: a, nodes: {m: {components: {eye: {plugin: a/B, remappings: {image: ~in}}}}}}"
    plan = find(release(text), "ConfigMap", "m-parameters")["data"]["components.json"]
    (component,) = json.loads(plan)["components"]
    assert component["remappings"] == {"/image": "/eye/in"}


@pytest.mark.parametrize(("ros", "names"), [("1", {"/m"}), ("2", {"/m", "/robot/eye"})])
def test_components_are_looked_for_where_they_are_nodes_of_the_graph(
    ros: Any, names: set[str]
) -> None:
    """The master knows the manager only; in DDS each component announces itself."""
    text = "{image: a, deploy_ros_master: false, nodes: {m: {components:"
    text += " {eye: {package: a, plugin: b, namespace: robot}}}}}"
    context = ReleaseContext("robots", "robot", "jazzy", GENERATIONS[ros])
    own = Parts(options(text), context, Texts())
    assert set(own.watched_graph(own.plan(())).expected) == names
