"""Why a workload is not ready: from its pods, its owner's conditions and the events; pure.

Every cause has a kind; patience.py defines how long each kind may last.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

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


@attrs.frozen
class Cause:
    """One reason why a workload is not ready.

    Attributes:
        kind: image, image-name, start, crash, restarted, unschedulable, claim, quota, mount,
            sandbox, evicted, failed or away.
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


def pods_of(
    workload: Manifest, replica_sets: Iterable[Manifest], pods: Iterable[Manifest]
) -> list[Manifest]:
    """Return the pods of a workload's newest template, as far as its kind shows them."""
    uid = workload["metadata"]["uid"]
    if workload["kind"] == "Pod":
        return [pod for pod in pods if pod["metadata"]["uid"] == uid]
    owners = {uid}
    if workload["kind"] == "Deployment":
        owners = {rs["metadata"]["uid"] for rs in find_newest(workload, replica_sets)}
    found = [pod for pod in pods if owner(pod) in owners]
    label, newest = newest_template(workload)
    if not newest:
        return found
    return [pod for pod in found if (pod["metadata"].get("labels") or {}).get(label) == newest]


def newest_template(workload: Manifest) -> tuple[str, str]:
    """Return a label of a workload's pods and its newest value, "" if its kind has none."""
    if workload["kind"] == "StatefulSet":
        revision = (workload.get("status") or {}).get("updateRevision")
        return "controller-revision-hash", str(revision or "")
    if workload["kind"] == "DaemonSet":
        notes = workload["metadata"].get("annotations") or {}
        generation = notes.get("deprecated.daemonset.template.generation")
        return "pod-template-generation", str(generation or "")
    return "", ""


def find_newest(deployment: Manifest, replica_sets: Iterable[Manifest]) -> Iterator[Manifest]:
    """Yield the ReplicaSet of a Deployment's newest template."""
    note = "deployment.kubernetes.io/revision"
    number = (deployment["metadata"].get("annotations") or {}).get(note)
    for replica_set in replica_sets:
        notes = replica_set["metadata"].get("annotations") or {}
        if owner(replica_set) == deployment["metadata"]["uid"] and notes.get(note) == number:
            yield replica_set


def owner(live: Manifest) -> str:
    """Return the UID of the controller that owns an object, "" for none."""
    for reference in live["metadata"].get("ownerReferences") or []:
        if reference.get("controller"):
            return str(reference["uid"])
    return ""


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
            yield explain_scheduling(str(condition.get("message", "")), name)
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


def explain_scheduling(message: str, pod: str) -> Cause:
    """Return why the scheduler finds no machine."""
    lowered = message.lower()
    if "persistentvolumeclaim" in lowered:
        return Cause("claim", f"a claim has no volume: {message}", pod)
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


def index_events(events: Iterable[Manifest]) -> dict[str, list[Manifest]]:
    """Return events by the UID of their object: a thousand pods must not read all of them."""
    found: dict[str, list[Manifest]] = {}
    for event in events:
        found.setdefault(event["involvedObject"].get("uid", ""), []).append(event)
    return found


def choose_events(events: Mapping[str, Sequence[Manifest]], *objects: Manifest) -> list[Manifest]:
    """Return the events about some objects, out of those that are indexed."""
    return [event for live in objects for event in events.get(live["metadata"]["uid"], ())]


def containers(status: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the states of all containers, those of init containers first."""
    return [*(status.get("initContainerStatuses") or []), *(status.get("containerStatuses") or [])]
