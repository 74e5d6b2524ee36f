"""What generations without a master share: checks, and the graph from DDS discovery."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.parameters import list_global_keys
from rigel_k8s.network.modes import mode_of
from rigel_k8s.problems import Problem

if TYPE_CHECKING:
    from rigel_k8s.discovery.members import Member
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.rosgraph.pods import GraphPod
    from rigel_k8s.rosgraph.types import RosGraph

ZENOH = (
    "ros_metrics: the exporter supports DDS but not zenoh, so this application has no metrics of"
    " its ROS graph; set `ros_metrics: false` to turn this warning off"
)


def check(options: OrchestrationOptions, title: str) -> Iterator[Problem]:
    """Yield options for a master in an application without one."""
    requested = {
        ("deploy_ros_master",): options.deploy_ros_master,
        ("ros_master_uri",): options.ros_master_uri,
        ("ros_master_image",): options.ros_master_image,
        ("ros_master_placement",): options.ros_master_placement.node_selector,
        ("additional_k8s_params", "ros_master"): options.additional_k8s_params.ros_master,
    }
    for path, value in requested.items():
        if value:
            message = f"{title} has no master: remove it; nodes find each other by `network`"
            yield Problem(path, message, "no-master-in-ros2", at_key=True)
    for key in list_global_keys(options):
        message = f"{title} has no global parameters: write them as {key} of the nodes"
        yield Problem((key,), message, "no-global-parameters", at_key=True)


def explain_unseen(options: OrchestrationOptions) -> str | None:
    """Return why an exporter would see nothing: the discovery of zenoh cannot be read."""
    middleware = options.middleware or mode_of(options.network).middleware
    return ZENOH if middleware == "zenoh" else None


def read_graph(cluster: Cluster, pods: Sequence[GraphPod], members: Sequence[Member]) -> RosGraph:
    """Return the graph of the domain."""
    from rigel_k8s.rosgraph.dds import read

    return read(cluster, pods, members)
