"""Nodes start again with their roscore and their global parameters, and only with their own."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.app.desired import draft
from rigel_k8s.app.generation import Texts
from rigel_k8s.app.generations.ros1.globalparameters import PARAMETERS_ANNOTATION
from rigel_k8s.app.generations.ros1.master import MASTER_ANNOTATION
from rigel_k8s.app.options import KubernetesParams, NodeOptions, OrchestrationOptions
from rigel_k8s.objects.marks import FIRST_ANNOTATION
from rigel_k8s.objects.scalars import ImageRef, ObjectName, RosUri
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Application


def templates(**options: Any) -> dict[str, dict[str, Any]]:
    """Return each Deployment's pod annotations."""
    talker = NodeOptions(image=ImageRef("app:1"), args=["talker"])
    made = draft(
        OrchestrationOptions(
            deployment_name=ObjectName("app"), nodes={"talker": talker}, **options
        ),
        ReleaseId("lab", "app"),
        Application("noetic"),
        Texts({"ready.sh": ""}),
    ).finish()
    return {
        item["metadata"]["name"]: item["spec"]["template"]["metadata"].get("annotations", {})
        for item in made.objects
        if item["kind"] == "Deployment"
    }


def test_a_changed_master_changes_its_nodes_pods() -> None:
    """Without a gate they would run on as orphans of a master that forgot them."""

    def mark(image: str) -> str:
        return templates(ros_master_image=ImageRef(image), gate=False)["talker"][MASTER_ANNOTATION]

    assert mark("ros:1") != mark("ros:2")
    assert mark("ros:1") == mark("ros:1")


def test_behind_a_gate_a_changed_master_leaves_its_nodes_alone() -> None:
    """It gets its registrations back."""
    assert MASTER_ANNOTATION not in templates(ros_master_image=ImageRef("ros:1"))["talker"]


def test_a_robots_own_master_binds_nothing() -> None:
    """We do not know when it starts anew."""
    found = templates(ros_master_uri=RosUri("http://robot:11311"))
    assert MASTER_ANNOTATION not in found["talker"]


FOR_EVER = {"key": "node.kubernetes.io/unreachable", "operator": "Exists", "effect": "NoExecute"}


@pytest.mark.parametrize(
    ("tolerations", "published"),
    [([], None), ([FOR_EVER], True), ([{**FOR_EVER, "tolerationSeconds": 20}], None)],
)
def test_the_pod_of_a_lost_machine_is_left_out_of_the_service(
    tolerations: list[dict[str, object]],
    published: bool | None,  # noqa: FBT001 - a parameter of the test
) -> None:
    """Another pod takes its place and gets all calls; one that never moves keeps its address."""
    pod = {"spec": {"template": {"spec": {"tolerations": tolerations}}}}
    made = draft(
        OrchestrationOptions(
            nodes={"talker": NodeOptions(image=ImageRef("app:1"))},
            additional_k8s_params=KubernetesParams(ros_master=pod),
        ),
        ReleaseId("lab", "app"),
        Application("noetic"),
        Texts({"ready.sh": ""}),
    ).finish()
    [service] = [item for item in made.objects if item["kind"] == "Service"]
    assert service["metadata"]["name"] == "ros-master"
    assert service["spec"].get("publishNotReadyAddresses") is published


def test_changed_global_parameters_start_nodes_again() -> None:
    """They read parameters at their start; what sets them is ready before, and roscore stays."""

    def notes(**options: Any) -> dict[str, Any]:
        found = templates(**options)
        return {name: notes.get(PARAMETERS_ANNOTATION) for name, notes in found.items()}

    first = notes(parameters={"speed": 1})
    again = notes(parameters={"speed": 2})
    assert first["talker"] == first["app-global-parameters"] is not None
    assert first["talker"] != again["talker"]
    assert first["ros-master"] is None
    assert notes(parameters={"speed": 1}) == first
    assert notes() == {"ros-master": None, "talker": None}


def test_global_parameters_are_set_by_an_image_that_is_there() -> None:
    """The job's; roscore's where each node has one of its own."""

    def image(**options: Any) -> str:
        talker = NodeOptions(image=ImageRef("talker:1"), args=["talker"])
        made = draft(
            OrchestrationOptions(nodes={"talker": talker}, parameters={"a": 1}, **options),
            ReleaseId("lab", "app"),
            Application("noetic"),
            Texts({"ready.sh": ""}),
        )
        (setter,) = (
            item
            for item in made.objects
            if item["kind"] == "Deployment" and "global" in item["metadata"]["name"]
        )
        assert setter["metadata"]["annotations"][FIRST_ANNOTATION] == "true"
        return str(setter["spec"]["template"]["spec"]["containers"][0]["image"])

    assert image(image=ImageRef("robot:1")) == "robot:1"
    assert image(application_image=ImageRef("app:1")) == "app:1"
    assert image(ros_master_image=ImageRef("master:1")) == "master:1"
    assert image() == "ros:noetic-ros-core"
