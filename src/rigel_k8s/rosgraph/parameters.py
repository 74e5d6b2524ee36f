"""The parameters of a release's ROS 1 master, read from inside one of its pods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rosgraph.inside import read_module, run_inside
from rigel_k8s.rosgraph.pods import GraphPod, read_pods
from rigel_k8s.rosgraph.ros1 import PYTHONS, choose_pod

SCRIPT = "rigel_inpod.sent.ros1_parameters"


def list_parameters(cluster: Cluster, release: ReleaseId) -> list[str]:
    """Return the names of all parameters.

    Raises:
        UserError: the release does not use ROS 1.
        ClusterError: the master does not answer.
    """
    return list(_ask(cluster, find_pod(cluster, release))["names"])


def read_parameter(cluster: Cluster, release: ReleaseId, name: str) -> tuple[Any, ...]:
    """Return a parameter's value alone; nothing if it does not exist. Raises as list_parameters."""
    found = _ask(cluster, find_pod(cluster, release), name)
    return (found["value"],) if "value" in found else ()


def find_pod(cluster: Cluster, release: ReleaseId) -> GraphPod:
    """Return the pod in which to run the request. Raises as list_parameters."""
    items = cluster.list("v1", "Pod", release.namespace, labels={RELEASE_LABEL: release.name})
    pods = read_pods(items)
    if pods and all(pod.ros.dds for pod in pods):
        raise UserError(
            f"{release.name} has no ROS master with parameters",
            hint="`ros2 param` in `rigel exec` shows those of a ROS 2 node",
        )
    return choose_pod(pods)


def _ask(cluster: Cluster, pod: GraphPod, *words: str) -> Mapping[str, Any]:
    modules = [("ros1_parameters", read_module(SCRIPT))]
    return run_inside(cluster, pod, modules, words, pythons=PYTHONS)
