"""The parameters of a ROS 1 master, read by a program that is run in a pod."""

from __future__ import annotations

import json
import sys
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.network.wiring import NETWORK_ANNOTATION
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rosgraph.parameters import list_parameters, read_parameter
from tests.support.pythons import find_python
from tests.support.rosgraph import ros_graph

from .local import LocalCluster

pytestmark = pytest.mark.programs

RELEASE = ReleaseId("robots", "robot")


class OnePod(LocalCluster):
    """A cluster with one pod, which is this machine."""

    ros = "1"

    def list(self, *_: Any, **__: Any) -> list[dict[str, Any]]:
        meta: dict[str, Any] = {
            "name": "here",
            "namespace": "robots",
            "labels": {RELEASE_LABEL: "robot"},
        }
        meta["annotations"] = {NETWORK_ANNOTATION: json.dumps({"ros": self.ros})}
        container = {"name": "ros-node"}
        state = {"name": "ros-node", "state": {"running": {}}}
        status = {"phase": "Running", "containerStatuses": [state]}
        return [{"metadata": meta, "spec": {"containers": [container]}, "status": status}]


@pytest.mark.parametrize("python", ["2.7", "3"])
def test_parameters_have_the_types_that_the_master_has(
    python: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = sys.executable if python == "3" else find_python(python)
    monkeypatch.setattr("rigel_k8s.rosgraph.parameters.PYTHONS", ["no-python3", found])
    with ros_graph() as graph:
        values = {"/rate": 2.5, "/a/list": [1, "x", True], "/tree": {"k": "ü"}, "/run_id": "run-1"}
        graph.master.parameters = values  # type: ignore[assignment]
        cluster: Any = OnePod(ROS_MASTER_URI=graph.master.uri)
        assert list_parameters(cluster, RELEASE) == sorted(values)
        for name, value in values.items():
            assert read_parameter(cluster, RELEASE, name) == (value,)
        assert read_parameter(cluster, RELEASE, "/missing") == ()


def test_a_master_that_does_not_answer_is_an_error() -> None:
    cluster: Any = OnePod(ROS_MASTER_URI="http://127.0.0.1:9/")
    with pytest.raises(ClusterError, match="does not answer"):
        list_parameters(cluster, RELEASE)


def test_ros_2_has_no_master() -> None:
    cluster: Any = OnePod()
    cluster.ros = "2"
    with pytest.raises(UserError, match="no ROS master"):
        list_parameters(cluster, RELEASE)
