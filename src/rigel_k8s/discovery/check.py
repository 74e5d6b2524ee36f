"""Whether a release's DDS nodes discover each other, examined from inside their pods.

A ROS 2 node whose multicast does not arrive runs and is ready, but no other node discovers it.
docs/discovery.md describes how this is detected and what it costs.
"""

from __future__ import annotations

import threading
import time

from rigel_k8s.discovery.findings import DiscoveryGraph, graph
from rigel_k8s.discovery.looks import LISTEN, look
from rigel_k8s.discovery.members import members
from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.text import plural
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter

PATIENCE = 20.0  # seconds that the nodes have to discover each other after a deploy
AGAIN = 1.0  # seconds between two looks
LONGER = 6.0  # seconds for a look that decides
#: Findings that a busy machine may cause too: a node without processor time does not answer.
DOUBTFUL = frozenset({"deaf", "deaf-pod", "no-server", "silent", "undiscovered"})


class GraphError(RigelK8sError):
    """Nodes do not discover each other as the Rigelfile requests; the release is deployed."""


def survey(
    cluster: Cluster, release: ReleaseId, cancel: threading.Event | None = None
) -> DiscoveryGraph | None:
    """Return a release's current graph, None if none of its pods takes part in DDS.

    If a busy machine may be the cause of a finding, a longer look decides.
    """
    found = look_briefly(cluster, release, cancel, LISTEN)
    if found is not None and any(problem.kind in DOUBTFUL for problem in found.errors):
        return look_briefly(cluster, release, cancel, LONGER)
    return found


def look_briefly(
    cluster: Cluster, release: ReleaseId, cancel: threading.Event | None, seconds: float
) -> DiscoveryGraph | None:
    """Return the graph that a look of so many seconds shows."""
    found = members(list_pods(cluster, release))
    return graph(found, look(cluster, found, cancel, seconds=seconds)) if found else None


def check(release: ReleaseId, cluster: Cluster, report: Reporter, cancel: threading.Event) -> None:
    """Look until the nodes discover each other, at most PATIENCE seconds and a look.

    Without `network`, nodes that do not discover each other are a warning: nothing requests it.

    Raises:
        GraphError: nodes do not discover each other, although `network` requests it.
        Interrupted: `cancel` was set.
    """
    until = time.monotonic() + PATIENCE
    found = look_briefly(cluster, release, cancel, LISTEN)
    while found is not None and found.errors and time.monotonic() < until:
        report.progress("graph", found.errors[0].message)
        if cancel.wait(AGAIN):
            raise Interrupted(
                "interrupted while checking the DDS graph; the release stays deployed"
            )
        found = look_briefly(cluster, release, cancel, LISTEN)
    if found is not None and found.errors:
        found = survey(cluster, release, cancel)
    if found is not None:
        report_graph(found, release, report)


def report_graph(found: DiscoveryGraph, release: ReleaseId, report: Reporter) -> None:
    """Print a graph and its warnings; raise GraphError if it has errors."""
    report.progress("graph", summary(found), done=True)
    for problem in found.problems:
        if not problem.is_error:
            report.warn(problem.text)
    if found.errors:
        count = len(found.errors)
        raise GraphError(
            f"{release.name} in {release.namespace} is deployed, but its nodes do not all"
            " discover each other",
            details=[problem.text for problem in found.errors],
            hint=f"check again with `rigel status` ({plural(count, 'problem')})",
        )


def summary(found: DiscoveryGraph) -> str:
    """Return the result in one line."""
    if found.problems:
        return f"checked from inside {len(found.pods)} pods"
    machines = len({pod.machine for pod in found.pods})
    where = f"on {plural(machines, 'machine')}"
    if any(pod.discovered_by is None for pod in found.pods):
        return f"all {len(found.pods)} nodes reach their discovery server or router, {where}"
    return f"all {len(found.pods)} nodes discover each other, {where}"
