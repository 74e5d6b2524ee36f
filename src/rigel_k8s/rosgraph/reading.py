"""Reads a release's ROS graph from its cluster: `read_graph`.

Why one entry: a user of a graph (a picture of it, a comparison of two) is independent of a
release's ROS version, and of how the graph is read. Nothing is written, and no node notices.
"""

from __future__ import annotations

import attrs

from rigel_k8s.discovery.members import members
from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rosgraph.pods import expected_nodes, find_leaving, place_nodes, read_pods
from rigel_k8s.rosgraph.types import RosGraph


def read_graph(cluster: Cluster, release: ReleaseId) -> RosGraph:
    """Return the graph that a release's nodes are in, perhaps with others; this takes seconds.

    Nodes that the release expects and that are missing are in it with `registered` False.

    Raises:
        UserError: nothing of the release is on the cluster.
        ClusterError: the graph cannot be read; the message has the cause.
    """
    items = list_pods(cluster, release)
    own = {RELEASE_LABEL: release.name}
    deployments = cluster.list("apps/v1", "Deployment", release.namespace, labels=own)
    pods, participants = read_pods(items), members(items)
    if not pods:
        raise UserError(
            f"no pod of {release.name} is in the namespace {release.namespace}",
            hint="`rigel status` shows what runs; -n names another namespace",
        )
    ros = next((pod.ros for pod in pods if bool(participants) == pod.ros.dds), pods[0].ros)
    graph = ros.read_graph(cluster, pods, participants)
    return attrs.evolve(
        graph,
        nodes=place_nodes(graph.nodes, pods, expected_nodes(deployments)),
        leaving=find_leaving(items),
    )
