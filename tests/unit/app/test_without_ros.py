"""A program without ROS beside ROS nodes (`ros: none` on a node): a web server, a broker."""

from __future__ import annotations

import json

import pytest

from rigel_graph.discovery.members import member_of
from rigel_k8s.app.generations.ros1.master import MASTER_ANNOTATION

from .shapes import find, problems, release

ROS1 = "{image: a, nodes: {talker: {args: [t]}, web-server: {ros: none, args: [w, -v]}}}"
ROS2 = f"# distro: jazzy\n{ROS1}"
BOTH = pytest.mark.parametrize("text", [ROS1, ROS2], ids=["1", "2"])


@BOTH
def test_it_may_be_there_twice_and_be_called_anything(text: str) -> None:
    """Only ROS allows one node of a name, and no hyphen in it."""
    for written in (text, text.replace("ros: none", "ros: none, replicas: 2")):
        assert not [p for p in problems(written) if p.severity == "error"]


def test_it_does_not_start_again_with_roscore() -> None:
    """It is no orphan of a roscore that has restarted."""
    made = release(ROS1.replace("{image", "{gate: false, image"))

    def annotations(name: str) -> dict[str, str]:
        template = find(made, "Deployment", name)["spec"]["template"]
        return dict(template["metadata"]["annotations"])

    assert MASTER_ANNOTATION in annotations("talker")
    assert MASTER_ANNOTATION not in annotations("web-server")


@pytest.mark.parametrize("network", ["", "network: peers, "])
def test_no_one_expects_it_in_the_graph(network: str) -> None:
    """The look at DDS passes its pod by, so it is no warning that it has no participant."""
    made = release(ROS2.replace("{image", "{" + network + "image"))

    def member(name: str) -> object:
        template = find(made, "Deployment", name)["spec"]["template"]
        return member_of(template | {"metadata": {**template["metadata"], **NAMED}})

    assert member("talker") is not None
    assert member("web-server") is None


NAMED = {"name": "pod", "namespace": "robots"}


def test_the_exporter_does_not_expect_it() -> None:
    text = ROS1.replace("{image", "{observability: {enabled: true}, image").replace("web-", "web_")
    found = find(release(text), "ConfigMap", "rigel-k8s-application-ros-exporter")
    config = found["data"]["config.json"]
    assert "/talker" in json.loads(config)["expected"]
    assert "web" not in config


@pytest.mark.parametrize(
    "key", ["name: x", "package: p", "parameters: {a: 1}", "launch: {file: f}"]
)
def test_what_only_ros_reads_is_refused(key: str) -> None:
    [found] = problems(f"{{image: a, nodes: {{n: {{ros: none, {key}}}}}}}")
    assert (found.kind, found.severity) == ("not-ros", "error")
    assert "a program without ROS (ros: none) has no" in found.message


@pytest.mark.parametrize(
    ("distro", "readiness", "wrong"),
    [("noetic", "ros", True), ("noetic", "dds", True), ("jazzy", "ros", True)]
    + [("jazzy", "dds", False), ("noetic", "none", False), ("jazzy", "{file: /r}", False)],
)
def test_a_readiness_that_it_never_reaches_is_refused(
    distro: str, readiness: str, *, wrong: bool
) -> None:
    found = problems(f"{{image: a, nodes: {{n: {{ros: none, readiness: {readiness}}}}}}}", distro)
    assert [p.kind for p in found] == ["not-ros"] * wrong


def test_a_second_container_in_its_pod_is_no_matter_of_dds() -> None:
    patch = "patch: {spec: {template: {spec: {containers: [{name: more, image: b}]}}}}"
    assert not problems(f"{{image: a, nodes: {{n: {{ros: none, {patch}}}}}}}", "jazzy")
