"""The state of each node of a release, with its cause, as a page shows it; pure.

A node here is a workload: what one entry of the Rigelfile's `nodes` runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

import attrs

from rigel_k8s.objects.facts import find_condition, is_ending, is_ready, stays_ready
from rigel_k8s.objects.marks import REMEDY_ANNOTATION
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.pods import MASTER_NAME
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.release.rollout.causes import containers, explain_exit
from rigel_k8s.release.status import AWAY, ReleaseStatus, WorkloadStatus

#: The states, the worst first.
CRASHED, BLOCKED, UNREACHABLE = "crashed", "blocked", "unreachable"
#: Its update has failed, and the version before still runs.
OUTDATED = "outdated"
UNREADY, STARTING, STOPPED, READY = "unready", "starting", "stopped", "ready"
#: It ran once, and has succeeded.
DONE = "done"
STATES = (CRASHED, BLOCKED, UNREACHABLE, OUTDATED, UNREADY, STARTING, STOPPED, DONE, READY)
#: Kinds of causes (release/rollout/causes.py) that mean that a container has ended.
ENDED = frozenset({"crash", "restarted", "failed", "evicted"})


def node_entry(
    workload: WorkloadStatus,
    pods: Sequence[Manifest],
    *,
    crashed: bool = False,
    machine: str = "",
    rolling: bool = False,
    good: int = 0,
) -> dict[str, Any]:
    """Return what a page shows of a node.

    Args:
        pods: the workload's pods as the cluster has them.
        crashed: a container has ended a few seconds ago, even if it runs again.
        machine: where it was last, for the moment in which no pod has a machine.
        rolling: a roll-out is in progress, so pods that were never ready are expected.
        good: the newest revision that became ready, 0 if none is known.
    """
    state = find_state(workload, pods, crashed=crashed, rolling=rolling)
    causes = find_causes(workload, pods, state)
    if state == OUTDATED and good:
        causes[0] = f"revision {good} still runs"
    living = [pod for pod in workload.pods if pod.phase != "Terminating"]
    return {
        "name": workload.annotations.get(ROS_NAME_ANNOTATION) or workload.name,
        "workload": workload.name,
        "kind": workload.kind,
        "helper": workload.name in (EXPORTER, MASTER_NAME),
        "state": state,
        "cause": "; ".join(causes),
        "brief": " ".join(causes[1:2] or causes[:1]),
        "remedy": "" if state == READY else workload.annotations.get(REMEDY_ANNOTATION, ""),
        "ready": workload.ready,
        "desired": workload.desired,
        "machine": next((pod.node for pod in (*living, *workload.pods) if pod.node), machine),
        "image": next((pod.image for pod in (*living, *workload.pods) if pod.image), ""),
        "restarts": sum(pod.restarts for pod in living),
        "pods": [attrs.asdict(pod) for pod in workload.pods],
    }


def find_state(
    workload: WorkloadStatus,
    pods: Sequence[Manifest],
    *,
    crashed: bool = False,
    rolling: bool = False,
) -> str:
    """Return the state of a node: the worst that is true of it."""
    kinds = set(workload.kinds)
    if workload.old_runs and (crashed or kinds):
        return OUTDATED
    if crashed or kinds & ENDED:
        return CRASHED
    if workload.done:
        if not workload.desired:
            return STOPPED
        return DONE if workload.kind == "Job" else READY
    if workload.halted and not kinds:
        return UNREADY if workload.desired else STOPPED
    if AWAY in kinds or any(pod.kind == AWAY and not pod.ready for pod in workload.pods):
        return UNREACHABLE
    if kinds:
        return BLOCKED
    if workload.kind == "Job" and any(map(stays_ready, pods)):
        return READY  # until it has ended
    waiting = [pod for pod in pods if not is_ending(pod) and not is_ready(pod)]
    if any(was_ready(pod) for pod in waiting):
        return UNREADY
    has_message = any(pod.message for pod in workload.pods if pod.phase != "Terminating")
    return UNREADY if has_message and not rolling else STARTING


def find_causes(workload: WorkloadStatus, pods: Sequence[Manifest], state: str) -> list[str]:
    """Return why a node is in its state, in the words of `rigel status`; [] if all is well.

    If not all pods are ready, the first text has their number.
    """
    if state in (READY, DONE) or (state == STOPPED and workload.done):
        return []
    if workload.halted and state in (STOPPED, UNREADY):
        return [workload.message]
    if workload.done:  # it has crashed, and runs again
        return ["it runs again", *(explain_end(pods) or ["it was restarted"])]
    shown = [pod for pod in workload.pods if pod.phase != "Terminating" or pod.kind == AWAY]
    messages = [workload.message, *(pod.message for pod in shown if not pod.ready)]
    # A pod's message repeats the cause that its workload's has.
    parts = [part for message in messages for part in message.split("; ") if part]
    return list(dict.fromkeys(parts))


def explain_end(pods: Iterable[Manifest]) -> list[str]:
    """Return how the containers of living pods ended last."""
    return [
        cause.message
        for pod in pods
        if not is_ending(pod)
        for container in containers(pod.get("status") or {})
        for cause in explain_exit(pod["metadata"]["name"], container)
    ]


def was_ready(pod: Manifest) -> bool:
    """Whether a pod that is not ready was ready since its containers started.

    Its condition Ready is false from the beginning; one that became so later was true before.
    """
    status = pod.get("status") or {}
    since = read_time(find_condition(status, "Ready").get("lastTransitionTime"))
    starts = [
        read_time(((container.get("state") or {}).get("running") or {}).get("startedAt"))
        for container in status.get("containerStatuses") or []
    ]
    known = [start for start in starts if start]
    return bool(since and known and len(known) == len(starts) and since > max(known))


def read_time(text: str | None) -> datetime | None:
    """Return a time of Kubernetes', None if it is missing."""
    try:
        return datetime.strptime(text or "", "%Y-%m-%dT%H:%M:%SZ")
    except ValueError:
        return None


def release_entry(
    found: ReleaseStatus, nodes: Mapping[str, Mapping[str, Any]], *, changing: str | None
) -> dict[str, Any]:
    """Return what a page shows of a release as a whole.

    Args:
        nodes: the entries of its nodes.
        changing: who changes the release now, "" where no one does, None where that is unknown.
    """
    counts = dict.fromkeys(STATES, 0)
    for node in nodes.values():
        counts[node["state"]] += 1
    optional = {w.name for w in found.workloads if w.ok and not w.done}
    needed = [node for node in nodes.values() if node["workload"] not in optional]
    return {
        "revision": found.revision,
        "status": found.revision_status,
        "changing": changing,
        "counts": counts,
        "nodes": len(nodes),
        "ready": sum(map(is_well, nodes.values())),
        "well": not found.missing and all(map(is_well, needed)),
        "missing": list(found.missing),
    }


def is_well(node: Mapping[str, Any]) -> bool:
    """Whether a node is as the release wants it: ready, done, or stopped by that alone."""
    return node["state"] in (READY, DONE) or (node["state"] == STOPPED and not node["cause"])
