"""Reads a release's ROS graph from its cluster: `read_graph`.

Why one entry: a user of a graph (a picture of it, a comparison of two) is independent of a
release's ROS version, and of how the graph is read. Nothing is written, and no node notices.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs

from rigel_graph.discovery.members import Member, members
from rigel_graph.pods import (
    GraphPod,
    expected_nodes,
    find_leaving,
    mark_shared,
    place_nodes,
    read_pods,
)
from rigel_graph.types import SPAN, RosGraph
from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.ros import Ros


@attrs.frozen
class Listed:
    """A release's pods and Deployments, as the API server returned them."""

    pods: Sequence[dict[str, Any]]
    deployments: Sequence[dict[str, Any]]


def list_objects(cluster: Cluster, release: ReleaseId) -> Listed:
    """Return what runs now: a graph of it can be read while an update begins."""
    own = {RELEASE_LABEL: release.name}
    deployments = cluster.list("apps/v1", "Deployment", release.namespace, labels=own)
    return Listed(list_pods(cluster, release), deployments)


def read_graph(
    cluster: Cluster, release: ReleaseId, *, span: float = SPAN, listed: Listed | None = None
) -> RosGraph:
    """Return the graph that a release's nodes are in, perhaps with others; this takes seconds.

    Nodes that the release expects and that are missing are in it with `registered` False.

    Args:
        span: seconds between two readings, of which rates are made; 0 for no rates.
        listed: what the release has, if that is known.

    Raises:
        UserError: nothing of the release is on the cluster.
        ClusterError: the graph cannot be read; the message has the cause.
    """
    listed = listed or list_objects(cluster, release)
    pods, participants = read_pods(listed.pods), members(listed.pods)
    if not pods:
        raise UserError(
            f"no pod of {release.name} is in the namespace {release.namespace}",
            hint="`rigel status` shows what runs; -n names another namespace",
        )
    graph = read(choose_ros(pods, participants), cluster, pods, participants, span)
    nodes = place_nodes(graph.nodes, pods, expected_nodes(listed.deployments))
    return attrs.evolve(
        graph,
        nodes=nodes,
        topics=mark_shared(graph if span else graph.without_rates(), nodes, pods),
        leaving=find_leaving(listed.pods),
        span=span,
    )


def choose_ros(pods: Sequence[GraphPod], participants: Sequence[Member]) -> Ros:
    """Return how a release's graph is read, by its pods and those in DDS."""
    return next((pod.ros for pod in pods if bool(participants) == pod.ros.dds), pods[0].ros)


def read(
    ros: Ros, cluster: Cluster, pods: Sequence[GraphPod], members: Sequence[Member], span: float
) -> RosGraph:
    """Return the graph: what the nodes have noted, what discovery finds, or what a master has."""
    if ros.rmw:
        from rigel_graph import ros2

        return ros2.read(cluster, pods, members, span)
    if ros.dds:
        from rigel_graph import dds

        return dds.read(cluster, pods, members)
    from rigel_graph import ros1

    return ros1.read(cluster, pods, span)
