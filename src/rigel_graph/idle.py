"""Waits until an update may touch a robot: no action has a goal in progress, and topics are silent.

The nodes' own processes count goals and messages (rigel_rmw). A pod that cannot be read does not
count: it may be what the update repairs.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping

from rigel_exporter.notes import list_parts
from rigel_graph.pods import read_pods
from rigel_graph.ros2 import ask_all
from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter

AGAIN = 0.5  # seconds between two looks


def wait_until_idle(
    cluster: Cluster,
    release: ReleaseId,
    reporter: Reporter,
    cancel: threading.Event,
    seconds: float,
    silent: Mapping[str, float],
) -> None:
    """Return once no action of a release has a goal in progress, and some topics are silent.

    Args:
        seconds: how long that may take.
        silent: the topics, by their full names, and for how many seconds each must be so.

    Raises:
        ClusterError: it takes longer.
        Interrupted: `cancel` was set.
    """
    until, waited = time.monotonic() + seconds, False
    while busy := ", ".join(list_busy(cluster, release, silent)):
        if time.monotonic() >= until:
            raise ClusterError(
                f"not idle within {seconds:g} s: {busy}; nothing was changed",
                hint="run it again later, or at once with --now",
            )
        reporter.progress("idle", f"waits: {busy}")
        waited = True
        if cancel.wait(AGAIN):
            raise Interrupted("stopped while waiting until the robot is idle; nothing was changed")
    if waited:
        reporter.progress("idle", "nothing is in progress", done=True)


def list_busy(cluster: Cluster, release: ReleaseId, silent: Mapping[str, float]) -> list[str]:
    """Return what is in progress, in words: goals, and messages of topics that are not silent."""
    answers, _ = ask_all(cluster, read_pods(list_pods(cluster, release)), 0.0)
    firsts = {pod: answer["first"] for pod, answer in answers.items()}
    processes = (process for first in firsts.values() for process in first["processes"])
    actions = {action for process in processes for action in process.get("goals", ())}
    loud = {
        part.name
        for part in list_parts(firsts)
        if part.kind == "publisher"
        and part.silence is not None
        and part.silence < silent.get(part.name, 0.0)
    }
    goals = [f"{action} has a goal in progress" for action in sorted(actions)]
    return goals + [f"{topic} is published" for topic in sorted(loud)]
