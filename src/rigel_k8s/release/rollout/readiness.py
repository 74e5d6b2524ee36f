"""Whether an object is as its manifest describes it: object -> (done, ok, message); pure.

One function for each kind, as Kubernetes' own controllers report it. `done` without `ok` is a state
that waiting does not improve.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.objects.facts import find_condition, is_ending, is_met, stays_ready
from rigel_k8s.objects.refs import Manifest

UNSEEN = "its controller has not seen the change yet"


@attrs.frozen
class ObjectReadiness:
    """The state of an object; `ready` and `wanted` count pods if the kind has some.

    Attributes:
        old_runs: pods of the version before do the work until new ones are ready.
    """

    done: bool
    ok: bool
    message: str
    ready: int = 0
    wanted: int = 0
    old_runs: bool = False


def going(message: str, ready: int = 0, wanted: int = 0) -> ObjectReadiness:
    """Return a state that is not the final one yet."""
    return ObjectReadiness(False, True, message, ready, wanted)


def good(message: str, ready: int = 0, wanted: int = 0) -> ObjectReadiness:
    """Return the desired state."""
    return ObjectReadiness(True, True, message, ready, wanted)


def bad(message: str) -> ObjectReadiness:
    """Return a state that does not improve by waiting."""
    return ObjectReadiness(True, False, message)


def readiness(live: Manifest) -> ObjectReadiness:
    if live["metadata"].get("deletionTimestamp"):
        return going("is being deleted")
    status = live.get("status") or {}
    if status.get("observedGeneration", 0) < expected_generation(live):
        return going(UNSEEN)
    return KINDS.get(live["kind"], by_conditions)(live.get("spec") or {}, status)


def readiness_among(
    live: Manifest, newest: Iterable[Manifest], pods: Collection[Manifest]
) -> ObjectReadiness:
    """Return the state of a workload; an old version that is not ready does no work.

    A Deployment's status counts the ready pods of all its versions.

    Args:
        newest: its pods of the newest template.
        pods: all of its pods, as far as they are known.
    """
    state = readiness(live)
    if not state.old_runs:
        return state
    new = {pod["metadata"]["name"] for pod in newest}
    old = [pod for pod in pods if pod["metadata"]["name"] not in new]
    if not old or any(map(stays_ready, old)):
        return state
    return going(count_new(state.ready, state.wanted), state.ready, state.wanted)


def count_new(ready: int, wanted: int) -> str:
    """Return how many pods of the new version are ready, in words."""
    return f"{ready} of {wanted} new {'pod' if wanted == 1 else 'pods'} ready"


def readiness_without(
    live: Manifest, newest: Sequence[Manifest], pods: Collection[Manifest], away: Collection[str]
) -> ObjectReadiness:
    """Return the state of a workload, without pods on unreachable machines.

    Args:
        newest: its pods of the newest template.
        pods: all of its pods.
        away: the names of the machines whose pods are not waited for; it may be empty.
    """
    state = readiness_among(live, newest, pods)
    settling = is_ending(live) or state.message == UNSEEN
    if live["kind"] == "Job" and pods and not state.done and not settling:
        if any(pod["spec"].get("nodeName") not in away for pod in pods):
            return state
        return good("waits for an unreachable machine", 0, state.wanted)
    if not away or state.done or settling or live["kind"] not in REPLICATED:
        return state
    lost = [pod["spec"]["nodeName"] for pod in pods if pod["spec"].get("nodeName") in away]
    wanted = max(state.wanted - len(set(lost) if live["kind"] == "DaemonSet" else lost), 0)
    here = [pod for pod in newest if pod["spec"].get("nodeName") not in away]
    ready = sum(map(stays_ready, here))
    if ready < max(wanted, len(here)):
        return going(f"{ready} of {wanted} ready", ready, wanted)
    message = f"{ready} of {state.wanted} ready, the others are on unreachable machines"
    return good(message, ready, state.wanted)


def expected_generation(live: Manifest) -> int:
    """Return the generation that its controller must have seen, 0 if it has none."""
    seen = "observedGeneration" in (live.get("status") or {})
    tracked = seen or live["kind"] in ("Deployment", "StatefulSet", "DaemonSet")
    return int(live["metadata"].get("generation", 0)) if tracked else 0


def deployment(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return the state of a Deployment: all pods are of the new template and available."""
    wanted = int(spec.get("replicas", 1))
    updated = int(status.get("updatedReplicas", 0))
    ready = min(int(status.get("availableReplicas", 0)), wanted)
    if updated < wanted:
        has_old = int(status.get("replicas", 0)) > updated
        what = "pods are new" if has_old else "pods exist"
        return going(f"{updated} of {wanted} {what}", 0, wanted)
    if old := max(int(status.get("replicas", 0)) - updated, 0):  # those that end do not count
        message = count_new(max(ready - old, 0), wanted)
        if ready:
            message += ", the old version still runs"
        return ObjectReadiness(False, True, message, ready, wanted, old_runs=bool(ready))
    if int(status.get("terminatingReplicas") or 0) and wanted == 0:
        return going("its pods are still ending", 0, 0)
    if ready < wanted:
        return going(f"{ready} of {wanted} ready", ready, wanted)
    return good(f"{ready} of {wanted} ready", ready, wanted)


def stateful_set(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    wanted = int(spec.get("replicas", 1))
    strategy = spec.get("updateStrategy") or {}
    partition = int((strategy.get("rollingUpdate") or {}).get("partition") or 0)
    counted = "availableReplicas" if spec.get("minReadySeconds") else "readyReplicas"
    updated, ready = int(status.get("updatedReplicas", 0)), int(status.get(counted, 0))
    if strategy.get("type") != "OnDelete" and updated < max(wanted - partition, 0):
        return going(f"{updated} of {wanted - partition} pods are new", ready, wanted)
    if ready < wanted:
        return going(f"{ready} of {wanted} ready", ready, wanted)
    return good(f"{ready} of {wanted} ready", ready, wanted)


def daemon_set(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return the state of a DaemonSet on the machines that need it."""
    wanted = int(status.get("desiredNumberScheduled", 0))
    on_delete = (spec.get("updateStrategy") or {}).get("type") == "OnDelete"
    updated = int(status.get("updatedNumberScheduled", 0))
    ready = int(status.get("numberAvailable", 0))
    if not on_delete and updated < wanted:
        return going(f"{updated} of {wanted} pods are new", ready, wanted)
    if ready < wanted:
        return going(f"{ready} of {wanted} ready", ready, wanted)
    return good(f"{ready} of {wanted} ready", ready, wanted)


def job(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return the state of a Job; its pods count as ready when they have succeeded."""
    wanted = int(spec.get("completions") or 1)
    done = int(status.get("succeeded", 0))
    if is_met(status, "Failed"):
        found = find_condition(status, "Failed")
        once = found.get("reason") == "BackoffLimitExceeded" and spec.get("backoffLimit") == 0
        return bad("failed" if once else f"failed: {found.get('message', '')}")
    if is_met(status, "Complete"):
        return good("complete", done, wanted)
    if spec.get("suspend"):
        return good("suspended", 0, 0)
    runs = f"{done} of {wanted} complete" if wanted > 1 else "has not ended yet"
    return going(runs, done, wanted)


def pod(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return the state of a bare pod."""
    phase = status.get("phase", "Pending")
    if phase == "Failed":
        return bad(f"failed: {status.get('message') or status.get('reason') or 'see its log'}")
    if phase == "Succeeded":
        return good("completed", 1, 1)
    if is_met(status, "Ready"):
        return good("ready", 1, 1)
    return going(f"{phase}, not ready", 0, 1)


def claim(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    phase = status.get("phase", "Pending")
    if phase == "Bound":
        return good("bound")
    if phase == "Lost":
        return bad(f"its volume {spec.get('volumeName', '')} no longer exists")
    return going("not bound to a volume")


def volume(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return whether a volume can be claimed, or is claimed."""
    phase = status.get("phase", "Pending")
    if phase == "Failed":
        return bad(f"failed: {status.get('message', '')}")
    if phase == "Released":
        return bad("its claim was deleted; it accepts no other claim until its claimRef is removed")
    return good(phase) if phase in ("Available", "Bound") else going(phase)


def definition(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return whether a CustomResourceDefinition is served."""
    return good("served") if is_met(status, "Established") else going("not served yet")


def namespace(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    return going("is being deleted") if status.get("phase") == "Terminating" else good("active")


def at_once(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return done: a Service and similar kinds are complete when they are stored."""
    return good("there")


def by_conditions(spec: Mapping[str, Any], status: Mapping[str, Any]) -> ObjectReadiness:
    """Return the state from the conditions of an unknown kind; without conditions it is done."""
    for kind in ("Ready", "Available"):
        found = find_condition(status, kind)
        if found.get("status") == "False":
            return going(f"not {kind.lower()}: {found.get('message') or found.get('reason', '')}")
    return good("there")


REPLICATED = ("Deployment", "StatefulSet", "DaemonSet")
KINDS: Mapping[str, Callable[[Mapping[str, Any], Mapping[str, Any]], ObjectReadiness]] = {
    "Deployment": deployment,
    "StatefulSet": stateful_set,
    "DaemonSet": daemon_set,
    "Job": job,
    "Pod": pod,
    "PersistentVolumeClaim": claim,
    "PersistentVolume": volume,
    "CustomResourceDefinition": definition,
    "Namespace": namespace,
    "Service": at_once,
    "CronJob": at_once,
}
