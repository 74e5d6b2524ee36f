"""Whether a release's DDS nodes discover each other: looked at from inside their pods.

A ROS 2 node whose multicast goes nowhere runs, is ready, and is alone. docs/graph.md tells how this
is found out and what it costs.
"""

from __future__ import annotations

import threading
import time

from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.graph.findings import DiscoveryGraph, graph
from rigel_k8s.graph.looks import LISTEN, look
from rigel_k8s.graph.members import Member, members
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter

PATIENCE = 20.0  # seconds that the nodes have to discover each other after a deploy
AGAIN = 1.0  # seconds between two looks
LONGER = 6.0  # seconds for a look that decides
#: What a busy machine shows as well: who is not given the time to answer does not answer.
DOUBTFUL = frozenset({"deaf", "deaf-pod", "no-server", "silent", "undiscovered"})


class GraphError(RigelK8sError):
    """Nodes do not discover each other, or not as the Rigelfile says; the release is deployed."""


def survey(
    cluster: Cluster, release: ReleaseId, cancel: threading.Event | None = None
) -> DiscoveryGraph | None:
    """Return a release's graph as it is now, None where nothing of it takes part in DDS.

    Where something is wrong that a busy machine may explain too, a longer look decides.
    """
    found = look_briefly(cluster, release, cancel, LISTEN)
    if found is not None and any(finding.kind in DOUBTFUL for finding in found.errors):
        return look_briefly(cluster, release, cancel, LONGER)
    return found


def look_briefly(
    cluster: Cluster, release: ReleaseId, cancel: threading.Event | None, seconds: float
) -> DiscoveryGraph | None:
    """Return what one look of so many seconds shows."""
    found = participants(cluster, release)
    return graph(found, look(cluster, found, cancel, seconds=seconds)) if found else None


def participants(cluster: Cluster, release: ReleaseId) -> list[Member]:
    """Return the pods of a release that take part in DDS."""
    labels = {RELEASE_LABEL: release.name}
    return members(cluster.list("v1", "Pod", release.namespace, labels=labels))


def check(release: ReleaseId, cluster: Cluster, report: Reporter, cancel: threading.Event) -> None:
    """Look until the nodes discover each other, at most PATIENCE seconds and a look.

    Without `network` a graph in pieces is a warning: nobody said that it shall hold together.

    Raises:
        GraphError: something is wrong that the Rigelfile's `network` promises.
        Interrupted: `cancel` was set.
    """
    until = time.monotonic() + PATIENCE
    found = look_briefly(cluster, release, cancel, LISTEN)
    while found is not None and found.errors and time.monotonic() < until:
        report.progress("graph", found.errors[0].message)
        if cancel.wait(AGAIN):
            raise Interrupted("stopped while looking at the DDS graph; the release stays deployed")
        found = look_briefly(cluster, release, cancel, LISTEN)
    if found is not None and found.errors:
        found = survey(cluster, release, cancel)
    if found is not None:
        tell(found, release, report)


def tell(found: DiscoveryGraph, release: ReleaseId, report: Reporter) -> None:
    """Report a graph; raise GraphError where it has errors."""
    report.progress("graph", summary(found), done=True)
    for finding in found.findings:
        if not finding.error:
            report.warn(str(finding))
    if found.errors:
        count = len(found.errors)
        raise GraphError(
            f"{release.name} in {release.namespace} is deployed, but its nodes do not all"
            " discover each other",
            details=[str(finding) for finding in found.errors],
            hint=f"`rigel status` looks again ({count} finding{'s' * (count != 1)})",
        )


def summary(found: DiscoveryGraph) -> str:
    """Return in one line what was found."""
    if found.findings:
        return f"looked from inside {len(found.pods)} pods"
    machines = len({pod.machine for pod in found.pods})
    where = f"on {machines} machine{'s' * (machines != 1)}"
    if any(pod.discovered_by is None for pod in found.pods):
        return f"all {len(found.pods)} nodes reach their discovery server or router, {where}"
    return f"all {len(found.pods)} nodes discover each other, {where}"
