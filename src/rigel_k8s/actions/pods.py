"""logs, exec, forward: what is done with the pods of a ROS node."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO

import attrs

from rigel_k8s.actions.targets import Release, release
from rigel_k8s.deploy.types import RELEASE_LABEL
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import Cluster
from rigel_k8s.manifests.naming import NAME_LABEL, ROS_NAME_ANNOTATION
from rigel_k8s.rigelfile import nearest
from rigel_k8s.settings import Settings

__all__ = ["LogLine", "LogOptions", "Pod", "execute", "forward", "logs", "pods_of"]


@attrs.frozen
class Pod:
    """A pod of a release: its object's name, the workload and ROS name it stands for."""

    name: str
    namespace: str
    workload: str
    ros_name: str
    container: str
    phase: str
    created: str
    ready: bool


@attrs.frozen
class LogOptions:
    """Which log lines: of the last seconds, the last so many, of the container before."""

    follow: bool = False
    since: int | None = None
    tail: int | None = None
    previous: bool = False
    timestamps: bool = False


@attrs.frozen
class LogLine:
    """One line, and the workload and pod it is of."""

    workload: str
    pod: str
    text: str


def pod_of(item: dict[str, Any]) -> Pod:
    """Return what we need of a pod object."""
    meta, status = item["metadata"], item.get("status", {})
    conditions = {c["type"]: c["status"] for c in status.get("conditions", [])}
    return Pod(
        name=meta["name"],
        namespace=meta["namespace"],
        workload=meta.get("labels", {}).get(NAME_LABEL, ""),
        ros_name=meta.get("annotations", {}).get(ROS_NAME_ANNOTATION, ""),
        container=item["spec"]["containers"][0]["name"],
        phase="Terminating" if meta.get("deletionTimestamp") else status.get("phase", "Unknown"),
        created=meta.get("creationTimestamp", ""),
        ready=conditions.get("Ready") == "True",
    )


def release_pods(found: Release) -> list[Pod]:
    """Return all pods of a release."""
    items = found.cluster.list(
        "v1", "Pod", found.id.namespace, labels={RELEASE_LABEL: found.id.name}
    )
    return sorted((pod_of(item) for item in items), key=lambda p: (p.workload, p.created))


def pods_of(found: Release, node: str) -> list[Pod]:
    """Return the pods of a ROS node, named by its key, its ROS name or its Kubernetes name.

    Raises:
        UserError: no pod of the release is of such a node.
    """
    everything = release_pods(found)
    wanted = {node, "/" + node.lstrip("/")}
    chosen = [p for p in everything if {p.workload, p.ros_name, p.name} & wanted]
    if chosen:
        return chosen
    chosen = [p for p in everything if p.workload == node.strip("/").replace("_", "-").lower()]
    if chosen:
        return chosen
    names = sorted({p.workload for p in everything})
    if not names:
        raise UserError(
            f"no pod of {found.id.name} is in the namespace {found.id.namespace}",
            hint="`rigel status` tells what is there",
        )
    close = nearest(node, names)
    meant = f', did you mean "{close}"?' if close else ""
    raise UserError(f'no pod of a node "{node}"{meant}', hint=f"there are: {', '.join(names)}")


def running(pods: Sequence[Pod]) -> Pod:
    """Return the pod to work in: a ready one, else the youngest that runs.

    Raises:
        UserError: none runs.
    """
    alive = [p for p in pods if p.phase == "Running"]
    if not alive:
        raise UserError(
            f"no pod of {pods[0].workload} runs ({pods[-1].name} is {pods[-1].phase})",
            hint="`rigel status` says why",
        )
    return max(alive, key=lambda p: (p.ready, p.created))


def logs(settings: Settings, nodes: Sequence[str], options: LogOptions) -> Iterator[LogLine]:
    """Yield log lines of the nodes (all, where none is named); follows new pods where asked to."""
    found = release(settings)
    with found.cluster as cluster:
        chosen = [p for n in nodes for p in pods_of(found, n)] if nodes else release_pods(found)
        if options.follow:
            yield from followed(cluster, found, {p.workload for p in chosen}, options)
            return
        for pod in chosen:
            for text in pod_lines(cluster, pod, options):
                yield LogLine(pod.workload, pod.name, text)


def pod_lines(cluster: Cluster, pod: Pod, options: LogOptions, **more: Any) -> Iterator[str]:
    """Yield one pod's log lines."""
    return cluster.logs(
        pod.namespace,
        pod.name,
        pod.container,
        since_seconds=options.since,
        tail=options.tail,
        previous=options.previous,
        timestamps=options.timestamps,
        **more,
    )


def followed(
    cluster: Cluster, found: Release, workloads: set[str], options: LogOptions
) -> Iterator[LogLine]:
    """Yield lines of all pods of the workloads as they come, through roll-outs, until interrupted."""
    lines: queue.Queue[LogLine] = queue.Queue()
    stop = threading.Event()
    watcher = threading.Thread(
        target=follow_pods, args=(cluster, found, workloads, options, lines, stop), daemon=True
    )
    watcher.start()
    try:
        while watcher.is_alive() or not lines.empty():
            try:
                yield lines.get(timeout=0.2)
            except queue.Empty:
                continue
    finally:
        stop.set()


def follow_pods(
    cluster: Cluster,
    found: Release,
    workloads: set[str],
    options: LogOptions,
    lines: queue.Queue[LogLine],
    stop: threading.Event,
) -> None:
    """Watch the pods, and give each container's run a thread that follows its log."""
    known: set[tuple[str, int]] = set()
    while not stop.is_set():
        events = cluster.watch(
            "v1", "Pod", found.id.namespace, labels={RELEASE_LABEL: found.id.name}, cancel=stop
        )
        for event in events:
            pod = pod_of(event.object)
            restarts = started_runs(event.object)
            if pod.workload not in workloads or restarts is None:
                continue
            if (pod.name, restarts) not in known:
                first = not any(name == pod.name for name, _ in known)
                known.add((pod.name, restarts))
                threading.Thread(
                    target=follow_one,
                    args=(cluster, pod, options if first else LogOptions(), lines, stop),
                    daemon=True,
                ).start()


def started_runs(item: dict[str, Any]) -> int | None:
    """Return how often the first container was restarted, None while it has not started."""
    statuses = item.get("status", {}).get("containerStatuses", [])
    if not statuses or not ({"running", "terminated"} & set(statuses[0].get("state", {}))):
        return None
    return int(statuses[0].get("restartCount", 0))


def follow_one(
    cluster: Cluster,
    pod: Pod,
    options: LogOptions,
    lines: queue.Queue[LogLine],
    stop: threading.Event,
) -> None:
    """Put one container's log lines into the queue until it ends."""
    try:
        for text in pod_lines(cluster, pod, options, follow=True, cancel=stop):
            lines.put(LogLine(pod.workload, pod.name, text))
    except ClusterError as error:
        if not stop.is_set():
            lines.put(LogLine(pod.workload, pod.name, f"(its log ended: {error.message})"))


def execute(
    settings: Settings,
    node: str,
    command: Sequence[str],
    *,
    stdin: BinaryIO | None,
    stdout: BinaryIO,
    stderr: BinaryIO,
    tty: bool,
) -> int:
    """Run a command in a node's container with ROS set up; return its exit code."""
    from rigel_k8s.manifests.pods import SCRIPTS_PATH

    found = release(settings)
    with found.cluster as cluster:
        pod = running(pods_of(found, node))
        return cluster.exec(
            pod.namespace,
            pod.name,
            ["/bin/sh", f"{SCRIPTS_PATH}/exec.sh", *command],
            container=pod.container,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            tty=tty,
        )


def forward(settings: Settings, node: str, ports: dict[int, int]) -> Iterator[dict[int, int]]:
    """Forward local ports to a node's pod (remote -> local, 0 any); yield once, end by closing."""
    found = release(settings)
    with found.cluster as cluster:
        pod = running(pods_of(found, node))
        with cluster.port_forward(pod.namespace, pod.name, ports) as open_ports:
            yield dict(open_ports.ports)
            while True:
                time.sleep(3600)
