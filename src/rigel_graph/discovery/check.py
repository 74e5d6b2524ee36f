"""Whether a release's DDS nodes discover each other, examined from inside their pods.

A ROS 2 node whose multicast does not arrive runs and is ready, but no other node discovers it.
docs/discovery.md describes how this is detected and what it costs.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping

from rigel_graph.discovery.findings import DiscoveryGraph, graph
from rigel_graph.discovery.looks import Notes, look
from rigel_graph.discovery.members import members
from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.text import plural
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.rollout.causes import explain_pod
from rigel_k8s.release.rollout.standing import count_crashes
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter

PATIENCE = 20.0  # seconds that the nodes have to discover each other after a deploy
#: On a busy machine a look takes long, and discovery, too: so many looks may find what it may
#: cause, for so many seconds.
LOOKS, LONGEST = 8, 120.0
AGAIN = 1.0  # seconds between two looks
CRASH = 5.0  # seconds in which Kubernetes reports that a container has ended
LATER = 4.0  # seconds until a look that decides; processes note what they discover every 3
#: Findings that a busy machine may cause too: a node without processor time does not answer.
DOUBTFUL = frozenset({"deaf", "no-participant", "undiscovered"})


class DiscoveryError(RigelK8sError):
    """Nodes do not discover each other as the Rigelfile requests; the release is deployed."""


def survey(cluster: Cluster, release: ReleaseId) -> DiscoveryGraph | None:
    """Return a release's current graph, None if none of its pods takes part in DDS.

    A busy machine may be late with what it has discovered: a second look decides.
    """
    found = look_briefly(cluster, release)
    if found is not None and any(problem.kind in DOUBTFUL for problem in found.errors):
        time.sleep(LATER)
        return look_briefly(cluster, release)
    return found


def look_briefly(
    cluster: Cluster, release: ReleaseId, known: Notes | None = None
) -> DiscoveryGraph | None:
    """Return the graph that one look shows.

    Args:
        known: notes that were read a moment ago; what is in them is not read again.
    """
    found = members(list_pods(cluster, release))
    return graph(found, look(cluster, found, known)) if found else None


def check(
    release: ReleaseId,
    cluster: Cluster,
    report: Reporter,
    cancel: threading.Event,
    known: Notes | None = None,
) -> None:
    """Look until the nodes discover each other, or have had time for that.

    Without `network`, nodes that do not discover each other are a warning: nothing requests it.

    Args:
        known: notes that were read since the roll-out, for the first look.

    Raises:
        DiscoveryError: nodes do not discover each other, although `network` requests it; or a pod
            has crashed meanwhile.
        Interrupted: `cancel` was set.
    """
    before = {name_of(pod): count_crashes(pod) for pod in list_pods(cluster, release)}
    begun, looks = time.monotonic(), 1
    found = look_briefly(cluster, release, known)
    while found is not None and may_change(found, looks, time.monotonic() - begun):
        report.progress("graph", "not all nodes have discovered each other yet")
        if cancel.wait(AGAIN):
            raise Interrupted(
                "interrupted while checking the DDS graph; the release stays deployed"
            )
        found, looks = look_briefly(cluster, release), looks + 1
    if found is not None:
        refuse_crashes(cluster, release, before, found, cancel)
        report_graph(found, release, report)


def refuse_crashes(
    cluster: Cluster,
    release: ReleaseId,
    before: Mapping[str, int],
    found: DiscoveryGraph,
    cancel: threading.Event,
) -> None:
    """Raise DiscoveryError if a pod has crashed since it was ready.

    Its node was in the graph for a moment, or the pod could not be looked at.

    Args:
        before: how often each pod had crashed.
    """
    unseen = any(problem.kind == "not-looked" for problem in found.problems)
    until = time.monotonic() + (CRASH if unseen else 0.0)
    while True:
        pods = list_pods(cluster, release)
        crashed = [pod for pod in pods if count_crashes(pod) > before.get(name_of(pod), 0)]
        if crashed or time.monotonic() >= until or cancel.wait(AGAIN):
            break
    if crashed:
        causes = [f"{name_of(p)}: {one.message}" for p in crashed for one in explain_pod(p, ())]
        raise DiscoveryError(
            f"{release.name} in {release.namespace} is deployed, but {plural(len(crashed), 'pod')}"
            " crashed after being ready",
            details=causes or [name_of(pod) for pod in crashed],
            hint="see `rigel logs` and `rigel status`; `rigel history` lists the revisions before",
        )


def name_of(pod: Manifest) -> str:
    return str(pod["metadata"]["name"])


def may_change(found: DiscoveryGraph, looks: int, seconds: float) -> bool:
    """Return whether errors may go by themselves, after so many looks and seconds."""
    if seconds < PATIENCE:
        return bool(found.errors)
    kinds = {problem.kind for problem in found.errors}
    return bool(kinds) and kinds <= DOUBTFUL and looks < LOOKS and seconds < LONGEST


def report_graph(found: DiscoveryGraph, release: ReleaseId, report: Reporter) -> None:
    """Print a graph and its warnings; raise DiscoveryError if it has errors."""
    report.progress("graph", summary(found), done=True)
    for problem in found.problems:
        if not problem.is_error:
            report.warn(problem.text)
    if found.errors:
        count = len(found.errors)
        raise DiscoveryError(
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
        return f"{len(found.pods)} nodes run {where}; what some have discovered is unknown"
    return f"all {len(found.pods)} nodes discover each other, {where}"
