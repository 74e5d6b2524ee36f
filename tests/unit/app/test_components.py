"""What a node's components change: names, its own pod, and who is looked for in the graph."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_k8s.app.generation import GENERATIONS, Texts
from rigel_k8s.app.generations.ros1.commands import resolve
from rigel_k8s.app.workloads import Workloads
from rigel_k8s.objects.workloads import ReleaseContext

from .shapes import find, options, problems, release

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
    own = Workloads(options(text), context, Texts())
    assert set(own.watched_graph(own.plan(())).expected) == names


#: A remapping, and the generations whose nodes and components can have it.
REMAPPINGS = [
    ('"~/input": /x', "2 1"),
    ('"~input": /x', "1"),
    ("input: ~/x", "2 1"),
    ("input: ~x", "1"),
    ('"rostopic://a": /x', "2"),
    ('"other:topic": /x', "2"),
    ("a__b: /x", "1"),
    ("a: _x", "2"),
]


@pytest.mark.parametrize(("pair", "generations"), REMAPPINGS)
@pytest.mark.parametrize("ros", ["1", "2"])
def test_remappings_are_those_of_the_generation(ros: str, pair: str, generations: str) -> None:
    """Of a node and of a component, at the place of the name."""
    plugin = "{plugin: a/B, " if ros == "1" else "{package: a, plugin: 'a::B', "
    component = f"components: {{c: {plugin} remappings: {{{pair}}}}}}}"
    for node, path in (
        (f"args: x, remappings: {{{pair}}}", ("nodes", "n", "remappings")),
        (component, ("nodes", "n", "components", "c", "remappings")),
    ):
        text = f"{{image: a, ros: '{ros}', network: none, nodes: {{n: {{{node}}}}}}}"
        found = [p.path[:-1] for p in problems(text) if p.kind == "bad-ros-name"]
        assert found == ([] if ros in generations else [path])


#: A value of a parameter, and the generations that have none such.
VALUES = [
    ("", "1 2"),
    ("null", "1 2"),
    ("{b: }", "1 2"),
    ("{}", "2"),
    ("{b: {}}", "2"),
    ("[]", "2"),
    ("[[1], [2]]", "2"),
    ("[1, null]", "1 2"),
    ("5000000000", "1"),
    ("[9223372036854775808]", "1 2"),
    ("[1, 2.5]", ""),
    ("{b: [a, c]}", ""),
    ("'null'", ""),
]


@pytest.mark.parametrize(("value", "refused"), VALUES)
@pytest.mark.parametrize("ros", ["1", "2"])
def test_a_value_that_ros_does_not_have_is_refused(ros: str, value: str, refused: str) -> None:
    """Of a node and of a component; ROS 1 would try for ever, ROS 2 end or read a text."""
    plugin = "{plugin: a/B, " if ros == "1" else "{package: a, plugin: 'a::B', "
    for node, path in (
        (f"args: x, parameters: {{p: {value}}}", ("parameters", "p")),
        (
            f"components: {{c: {plugin} parameters: {{p: {value}}}}}}}",
            ("components", "c", "parameters", "p"),
        ),
    ):
        text = f"{{image: a, ros: '{ros}', network: none, nodes: {{n: {{{node}}}}}}}"
        found = [p.path for p in problems(text) if p.kind == "bad-parameter"]
        assert found == ([("nodes", "n", *path)] if ros in refused else [])
