"""Why a workload is not ready: from its pods, its owner's conditions and the events; pure.

Every cause has a kind: docs/errors.md is generated from these, and patience.py defines how long
each may last.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.kinds import Kind
from rigel_k8s.objects.facts import is_ending, is_out_of_reach
from rigel_k8s.objects.refs import Manifest

IMAGE = ("ErrImagePull", "ImagePullBackOff", "RegistryUnavailable", "ErrImageNeverPull")
BAD_NAME = "InvalidImageName"
#: Characters of a container's last words; Kubernetes keeps its message or the end of its log.
LONGEST_MESSAGE = 300
START = ("CreateContainerConfigError", "CreateContainerError", "RunContainerError")
EVENTS = {
    "FailedMount": "mount",
    "FailedAttachVolume": "mount",
    "FailedMapVolume": "mount",
    "FailedCreatePodSandBox": "sandbox",
    "NetworkNotReady": "sandbox",
}
#: A busy kubelet that has not yet read the pod's ConfigMaps and Secrets reports this and tries
#: again. One that does not exist is reported as "not found".
BUSY = re.compile(r"failed to sync (configmap|secret) cache")
#: What a runtime says of a probe in a container that has exited.
EXITED = re.compile(r"CONTAINER_EXITED|no running task|container is not running")
CAUSES: Mapping[str, Kind] = {
    "image": Kind(
        "the image cannot be pulled",
        "push it, correct its name, or give the namespace a pull secret",
    ),
    "image-name": Kind("the image's name is malformed", "correct `image`"),
    "start": Kind(
        "the container cannot be created, for example because a Secret or a program is missing",
        "create what the message names",
    ),
    "crash": Kind("the container ends again and again", "read its log: `rigel logs -p NODE`"),
    "restarted": Kind("the container has ended once and runs again", "read its log"),
    "unschedulable": Kind(
        "no machine accepts the pod", "change `placement`, `resources` or the machines' taints"
    ),
    "claim": Kind("a claim is not bound", "check its StorageClass and size"),
    "quota": Kind("a quota prevents further pods", "request less, or have it raised"),
    "mount": Kind("a volume cannot be mounted", "read the event in the message"),
    "sandbox": Kind(
        "the pod's network cannot be set up", "check Multus and the CNI on that machine"
    ),
    "evicted": Kind("the machine has evicted the pod", "free memory or disk space there"),
    "failed": Kind("the pod or the Job has failed for good", "read its log"),
    "away": Kind(
        "Kubernetes cannot reach the machine", "switch it on; pinned pods continue when it is back"
    ),
}


@attrs.frozen
class Cause:
    """One reason why a workload is not ready.

    Attributes:
        kind: one of CAUSES.
        pod: the pod that shows it, "" if none is the cause.
        previous: its log is that of the container's life before the last restart.
    """

    kind: str
    message: str
    pod: str = ""
    container: str = ""
    previous: bool = False

    @property
    def key(self) -> tuple[str, str]:
        """What identifies the cause when it is seen again, perhaps on another pod."""
        return ("crash" if self.kind == "restarted" else self.kind, self.container)


def causes(
    workload: Manifest,
    pods: Sequence[Manifest],
    events: Iterable[Manifest],
    owners: Sequence[Manifest] = (),
) -> list[Cause]:
    """Return why a workload is not ready, the clearest reason first.

    Args:
        pods: those of its newest template.
        events: warnings about anything.
        owners: the workload's ReplicaSets, whose events count as its own.
    """
    warnings = list(events)
    found = [*explain_owner(workload, owners, warnings)]
    living = [pod for pod in pods if not is_ending(pod)]
    for pod in living:
        found += explain_pod(pod, warnings)
    if not living:
        found += [explain_loss(pod) for pod in pods if is_out_of_reach(pod)]
    last_first = {cause.key: cause for cause in reversed(found)}.values()
    # Two containers may have one image that cannot be pulled.
    return list({cause.message: cause for cause in last_first}.values())[::-1]


def explain_owner(
    workload: Manifest, owners: Sequence[Manifest], events: Sequence[Manifest]
) -> Iterator[Cause]:
    """Yield why a workload's controller cannot make pods (a quota, an admission)."""
    for condition in (workload.get("status") or {}).get("conditions") or []:
        if condition.get("type") == "ReplicaFailure" and condition.get("status") == "True":
            yield Cause("quota", f"cannot create pods: {condition.get('message', '')}")
            return
    made_by = {live["metadata"]["uid"] for live in (workload, *owners)}
    if workload["kind"] not in ("Deployment", "Pod"):
        for event in events:
            if event["involvedObject"].get("uid") in made_by and event["reason"] == "FailedCreate":
                yield Cause("quota", f"cannot create pods: {event.get('message', '')}")


def explain_pod(pod: Manifest, events: Sequence[Manifest]) -> Iterator[Cause]:
    """Yield what is wrong with one pod."""
    name, status = pod["metadata"]["name"], pod.get("status") or {}
    for condition in status.get("conditions") or []:
        if condition.get("type") == "PodScheduled" and condition.get("status") == "False":
            yield explain_scheduling(str(condition.get("message", "")), name, events)
    if status.get("phase") == "Failed":
        reason = status.get("message") or status.get("reason") or "see its log"
        evicted = status.get("reason") == "Evicted"
        yield Cause("evicted" if evicted else "failed", f"pod {name} failed: {reason}", name)
    for container in containers(status):
        yield from explain_container(pod, container)
    yield from explain_by_events(pod, events)
    if is_out_of_reach(pod):
        yield explain_loss(pod)


def explain_loss(pod: Manifest) -> Cause:
    """Return the cause for a pod on a machine that Kubernetes has lost; it cannot end there."""
    state = "cannot be ended" if is_ending(pod) else "may still run"
    machine = pod["spec"]["nodeName"]
    message = f"Kubernetes cannot reach the machine {machine}, where the pod {state}"
    return Cause("away", message, pod["metadata"]["name"])


def explain_scheduling(message: str, pod: str, events: Iterable[Manifest]) -> Cause:
    """Return why the scheduler finds no machine; the events of a claim say more about that."""
    if "persistentvolumeclaim" in message.lower():
        what = f"a claim has no volume: {message}"
        for event in events:
            about = event["involvedObject"]
            if about.get("kind") == "PersistentVolumeClaim":
                what = f"claim {about['name']} has no volume: {event.get('message', '')}"
        return Cause("claim", what, pod)
    return Cause("unschedulable", f"no machine can run the pod: {message}", pod)


def explain_container(pod: Manifest, container: Mapping[str, Any]) -> Iterator[Cause]:
    """Yield why one container does not run."""
    name, own = pod["metadata"]["name"], container["name"]
    waiting = (container.get("state") or {}).get("waiting") or {}
    reason, message = waiting.get("reason", ""), waiting.get("message") or ""
    image = container.get("image", "")
    if reason == BAD_NAME:
        yield Cause("image-name", f"invalid image name {image!r}: {message}", name, own)
    elif reason in IMAGE:
        yield Cause(
            "image", f"image {image} cannot be pulled: {core(message) or reason}", name, own
        )
    elif reason in START:
        yield never_started(name, own, message or reason)
    elif not container.get("ready"):
        yield from explain_exit(name, container)


def list_restarts(pods: Iterable[Manifest]) -> Iterator[Cause]:
    """Yield how containers that are ready now have ended before."""
    for pod in pods:
        for container in containers(pod.get("status") or {}):
            if container.get("ready") and "running" in (container.get("state") or {}):
                yield from explain_exit(pod["metadata"]["name"], container)


def never_started(pod: str, container: str, message: str) -> Cause:
    """Return the cause of a program that the runtime cannot start.

    Between its attempts the container has ended, while it tries it waits: both are one cause.
    """
    return Cause("start", f"container {container} cannot be started: {message}", pod, container)


def core(message: str) -> str:
    """Return the useful part of a runtime's message: its layers repeat the image."""
    return message.rpartition('": ')[2] or message


def explain_exit(pod: str, container: Mapping[str, Any]) -> Iterator[Cause]:
    """Yield how a container ended, if it did."""
    state, last = container.get("state") or {}, container.get("lastState") or {}
    ended = state.get("terminated") or last.get("terminated")
    if not ended or (
        ended.get("exitCode") == 0
        and ended.get("reason") == "Completed"
        and not container.get("restartCount")
    ):
        return
    own, up = container["name"], "running" in state
    if ended.get("reason") == "StartError" and not up:
        yield never_started(pod, own, ended.get("message") or "")
        return
    # Without the number of restarts: nodes that fail alike have one message.
    message, kind = f"container {own} {exit_words(ended)}", "restarted" if up else "crash"
    yield Cause(kind, message, pod, own, previous=not state.get("terminated"))


def exit_words(ended: Mapping[str, Any]) -> str:
    """Return how a container ended, as a phrase."""
    code = ended.get("exitCode")
    if ended.get("reason") == "OOMKilled":
        return f"ran out of memory (OOMKilled, exit code {code}): raise its memory limit"
    signal = f", killed by signal {code - 128}" if code and code > 128 else ""
    own = " ".join((ended.get("message") or "").split())
    last = f"…{own[-LONGEST_MESSAGE:]}" if len(own) > LONGEST_MESSAGE else own
    return f"exited with code {code}{signal}" + (f" ({last})" if last else "")


def explain_by_events(pod: Manifest, events: Sequence[Manifest]) -> Iterator[Cause]:
    """Yield what the events report about a pod whose containers have not started."""
    name, status = pod["metadata"]["name"], pod.get("status") or {}
    started = any(map(is_past_mounts, containers(status)))
    for event in find_events(pod, events):
        kind, message = EVENTS.get(event["reason"], ""), event.get("message") or ""
        if kind and not started and not BUSY.search(message):
            yield Cause(kind, f"{event['reason']}: {message}", name)


def is_past_mounts(container: Mapping[str, Any]) -> bool:
    """Whether a pod has started, with its volumes: a container has run, or waits for its image."""
    state = container.get("state") or {}
    pulls = (state.get("waiting") or {}).get("reason") in IMAGE
    runs = "running" in state or "terminated" in state
    return bool(runs or container.get("lastState") or pulls)


def probe_failure(pod: Manifest, events: Iterable[Manifest]) -> str:
    """Return the output of the last probe of a pod that failed while it ran, "" if none did."""
    failed = [
        event
        for event in find_events(pod, events)
        if event["reason"] in ("Unhealthy", "ProbeWarning")
        and not EXITED.search(event.get("message") or "")
    ]
    failed.sort(key=lambda event: str(event.get("lastTimestamp") or event.get("eventTime") or ""))
    return " ".join(str(failed[-1].get("message", "")).split()) if failed else ""


def find_events(pod: Manifest, events: Iterable[Manifest]) -> Iterator[Manifest]:
    """Yield the events about a pod."""
    uid = pod["metadata"]["uid"]
    return (event for event in events if event["involvedObject"].get("uid") == uid)


def containers(status: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the states of all containers, those of init containers first."""
    return [*(status.get("initContainerStatuses") or []), *(status.get("containerStatuses") or [])]
