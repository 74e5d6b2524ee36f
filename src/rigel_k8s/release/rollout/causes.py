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
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.podnodes import shared_pod
from rigel_k8s.objects.refs import Manifest

IMAGE = ("ErrImagePull", "ImagePullBackOff", "RegistryUnavailable", "ErrImageNeverPull")
BAD_NAME = "InvalidImageName"
#: Characters of a container's last words; Kubernetes keeps its message or the end of its log.
LONGEST_MESSAGE = 300
#: A call in a traceback of Python, and files there that are not the user's own.
CALL = re.compile(r'\s+File "(.+)", line (\d+)')
INSTALLED = re.compile(r"/opt/ros/|/usr/lib/|<")
#: What looks like an error among the lines of a log.
ERROR = re.compile(
    r"(?!.*\[ *(DEBUG|INFO)\b).*(error|exception|fatal|\bfail(ed|ure)|\bfault\b"
    r"|not found|no such|non-unique|\bcan(no|')t|could ?n[o']t|\bunable|denied|invalid|undefined)",
    re.IGNORECASE,
)
#: Which line of our own script could not start a program; what follows is the shell's reason.
OURS = re.compile(r"^/rigel-k8s/[\w.]+: (line )?\d+: (exec: )?")
#: What the logs' collector prints, and what it means.
COLLECTOR = {
    re.compile(r'cannot start "\w+" exporter: timeout'): (
        "another collector uses the same directory of the machine: remove one of the two stacks"
    ),
    re.compile(r"^go\.etcd\.io/bbolt\.", re.MULTILINE): (
        "its files are damaged, as by a loss of power: delete /var/lib/rigel-otel-collector on the"
        " machine; it reads the present logs again then"
    ),
}
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
#: A path of the machine that does not exist there, or is something else than the volume's type.
NO_PATH = re.compile(
    r"hostPath type check failed[:,] (.+? is not an? [\w ]+)"
    r"(?:, (?:unable to determine its type.*: (.+)|(it's .+)))?"
)
#: What a probe prints of a pod that waits to take over.
TURN = re.compile(r"(?:\w+ probe failed: )?(.+) \[waits\]")
#: What a runtime says of a probe in a container that has exited.
EXITED = re.compile(
    r"CONTAINER_EXITED|no running task|container is not running|in a (deleted|stopped) state"
    r"|container not created|ttrpc: closed|probe failed:\s*$"
)
#: What the kubelet reports of a container that it will stop, and start again.
NOT_ALIVE = "Liveness probe failed: "
#: In the kubelet's words about a probe that could not run: one that has failed explains more.
NOT_RUN = "errored and resulted in unknown state"
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
    "path": Kind(
        "a path of the machine does not exist, or is something else",
        "create it there, plug the device in, or set the volume's `type`",
    ),
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
        brief: the message without the container's last words, which differ from start to start.
    """

    kind: str
    message: str
    pod: str = ""
    container: str = ""
    previous: bool = False
    brief: str = ""

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
    name, status = pod["metadata"]["name"], pod.get("status") or {}
    for condition in status.get("conditions") or []:
        if condition.get("type") == "PodScheduled" and condition.get("status") == "False":
            yield explain_scheduling(str(condition.get("message", "")), name, events)
    if status.get("phase") == "Failed":
        reason = status.get("message") or status.get("reason")
        ends = [] if reason else [one for c in containers(status) for one in explain_exit(name, c)]
        for one in ends:  # for good, so it is no crash after which it starts again
            yield attrs.evolve(one, kind="failed")
        if ends:
            return
        evicted = status.get("reason") == "Evicted"
        reason = reason or "see its log"
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


def find_crash(pod: Manifest) -> tuple[str, str]:
    """Return when a container that is ready now has ended last, and how; both "" if none has."""
    found = [
        (str(ended.get("finishedAt", "")), container)
        for container in containers(pod.get("status") or {})
        if container.get("ready")
        and (ended := (container.get("lastState") or {}).get("terminated"))
    ]
    when, container = max(found, key=lambda one: one[0], default=("", {}))
    causes_of = explain_exit(pod["metadata"]["name"], container) if container else iter(())
    return when, next((cause.message for cause in causes_of), "")


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
    brief = f"container {own} {exit_words(ended)}"
    last = find_last_words(ended.get("message") or "")
    message = f"{brief} ({last})" if last and ended.get("reason") != "OOMKilled" else brief
    kind, previous = "restarted" if up else "crash", not state.get("terminated")
    yield Cause(kind, message, pod, own, previous, brief)


def exit_words(ended: Mapping[str, Any]) -> str:
    """Return how a container ended, as a phrase."""
    code = ended.get("exitCode")
    if ended.get("reason") == "OOMKilled":
        return f"ran out of memory (OOMKilled, exit code {code}): raise its memory limit"
    signal = f", killed by signal {code - 128}" if code and code > 128 else ""
    return f"exited with code {code}{signal}"


def find_last_words(message: str) -> str:
    """Return the end of what a container has printed; of that, its errors if there are some.

    Of a Python traceback it is the error itself.
    """
    lines = [OURS.sub("", line) for line in message.splitlines() if line.strip()]
    calls = [(number, found) for number, line in enumerate(lines) if (found := CALL.match(line))]
    if calls:
        error = next((one for one in lines[calls[-1][0] + 1 :] if not one[0].isspace()), "")
        own = [call for _, call in calls if not INSTALLED.match(call[1])]
        if error:
            place = f", {own[-1][1]}:{own[-1][2]}" if own else ""
            return f"{error[:LONGEST_MESSAGE]}{place}"
    for words, meaning in COLLECTOR.items():
        if words.search(message):
            return meaning
    errors = [] if calls else [line for line in lines if ERROR.match(line)]
    text = " ".join(" ".join(dict.fromkeys(errors or lines)).split())
    return f"…{text[-LONGEST_MESSAGE:]}" if len(text) > LONGEST_MESSAGE else text


def explain_by_events(pod: Manifest, events: Sequence[Manifest]) -> Iterator[Cause]:
    """Yield what the events report about a pod whose containers have not started."""
    name, status = pod["metadata"]["name"], pod.get("status") or {}
    started = any(map(is_past_mounts, containers(status)))
    for event in find_events(pod, events):
        kind, message = EVENTS.get(event["reason"], ""), event.get("message") or ""
        if kind and not started and not BUSY.search(message):
            if path := NO_PATH.search(message):
                found = ": ".join(filter(None, path.groups()))
                yield Cause("path", f"on the machine {pod['spec'].get('nodeName')}, {found}", name)
            else:
                yield Cause(kind, f"{event['reason']}: {message}", name)


def is_past_mounts(container: Mapping[str, Any]) -> bool:
    """Whether a pod has started, with its volumes: a container has run, or waits for its image."""
    state = container.get("state") or {}
    pulls = (state.get("waiting") or {}).get("reason") in IMAGE
    runs = "running" in state or "terminated" in state
    return bool(runs or container.get("lastState") or pulls)


def probe_failure(pod: Manifest, events: Iterable[Manifest]) -> str:
    """Return the output of the last probe of a pod that failed while it ran, "" if none did.

    Of several nodes in a pod, it is that of one which does not only wait for its turn.
    """
    failed = list_probe_failures(pod, events)
    wrong = [name for name, text in failed.items() if not TURN.fullmatch(text)]
    name = next(iter([*wrong, *failed]), "")
    return f"{name}: {failed[name]}" if len(failed) > 1 else failed.get(name, "")


def list_probe_failures(pod: Manifest, events: Iterable[Manifest]) -> dict[str, str]:
    """Return the output of the last failed probe of each container that is not ready."""
    states = containers(pod.get("status") or {})
    ready = {one["name"] for one in states if one.get("ready")}
    failed = [
        event
        for event in find_events(pod, events)
        if event["reason"] in ("Unhealthy", "ProbeWarning")
        and not EXITED.search(event.get("message") or "")
    ]
    failed.sort(key=lambda event: (NOT_RUN not in str(event.get("message")), time_of(event)))
    found = {
        find_container(event): " ".join(str(event.get("message", "")).split()) for event in failed
    }
    return {name: text for name, text in found.items() if name not in ready}


def find_liveness_failure(pod: Manifest, events: Iterable[Manifest]) -> tuple[str, str]:
    """Return when its liveness probe last stopped a container of a pod, and what that reported.

    Both are "" where a container ended otherwise since then, or the event is no longer there.
    """
    lives = {
        one["name"]: ended
        for one in containers(pod.get("status") or {})
        for state in (one.get("lastState"), one.get("state"))
        if (ended := (state or {}).get("terminated"))
    }
    found = [
        (str(life.get("finishedAt")), " ".join(text.removeprefix(NOT_ALIVE).split()))
        for event in sorted(find_events(pod, events), key=time_of)
        if (text := str(event.get("message"))).startswith(NOT_ALIVE)
        and (life := lives.get(find_container(event)))
        and str(life.get("startedAt")) < time_of(event) <= str(life.get("finishedAt"))
    ]
    return max(found, key=lambda one: one[0], default=("", ""))


def time_of(event: Manifest) -> str:
    """Return when an event has happened last, as Kubernetes writes times."""
    return str(event.get("lastTimestamp") or event.get("eventTime") or "")


def find_turn(pod: Manifest, events: Iterable[Manifest]) -> str:
    """Return for what a pod waits that takes over from another one, "" if it does not wait.

    Its probe marks what it reports: such a pod is as it should be.
    """
    found = [TURN.fullmatch(text) for text in list_probe_failures(pod, events).values()]
    return next((one[1] for one in found if one and all(found)), "")


def find_events(pod: Manifest, events: Iterable[Manifest]) -> Iterator[Manifest]:
    """Yield the events about a pod, or about a node's part of it."""
    uid = pod["metadata"]["uid"]
    node = pod["metadata"].get("labels", {}).get(NAME_LABEL) if shared_pod(pod) else ""
    own = (event for event in events if event["involvedObject"].get("uid") == uid)
    return (event for event in own if not node or find_container(event) in ("", node))


def find_container(event: Manifest) -> str:
    """Return the container that an event is about, "" if it is about the whole pod."""
    path = str(event["involvedObject"].get("fieldPath") or "")
    return path.partition("{")[2].rstrip("}")


def containers(status: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the states of all containers, those of init containers first."""
    return [*(status.get("initContainerStatuses") or []), *(status.get("containerStatuses") or [])]
