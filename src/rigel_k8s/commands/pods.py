"""exec and forward, and how the pods of a ROS node are found."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO

import attrs

from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import UserError
from rigel_k8s.kube import Cluster
from rigel_k8s.objects.facts import is_ending, is_ready
from rigel_k8s.objects.naming import NAME_LABEL, NODE_ANNOTATION, ROS_NAME_ANNOTATION, object_name
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.release.pods import list_pods
from rigel_k8s.rigelfile import find_nearest
from rigel_k8s.settings import Settings

COMPONENT_LABEL, OBSERVABILITY = "app.kubernetes.io/component", "observability"
LOOK = 1.0  # seconds between two checks of a forward


@attrs.frozen
class Pod:
    """A pod of a release.

    Attributes:
        workload: the Kubernetes name of its workload.
        aliases: all names that a user may use for its node.
        container: its first container.
        scripts: whether that has the in-pod scripts.
        machine: the machine, "" before it is scheduled.
        restarts: of its first container.
        helper: it is not a node of the application but watches them (the ROS exporter).
    """

    name: str
    namespace: str
    workload: str
    aliases: frozenset[str]
    container: str
    scripts: bool
    phase: str
    created: str
    ready: bool
    ros_name: str = ""
    machine: str = ""
    restarts: int = 0
    helper: bool = False


def pod_of(item: dict[str, Any]) -> Pod:
    """Return what we need from a pod object."""
    meta, status = item["metadata"], item.get("status", {})
    notes = meta.get("annotations") or {}
    workload = (meta.get("labels") or {}).get(NAME_LABEL, "")
    ros_name = notes.get(ROS_NAME_ANNOTATION, "")
    container = item["spec"]["containers"][0]
    mounts = [mount["mountPath"] for mount in container.get("volumeMounts") or []]
    known = {meta["name"], workload, notes.get(NODE_ANNOTATION, ""), ros_name, ros_name[1:]}
    return Pod(
        name=meta["name"],
        namespace=meta["namespace"],
        workload=workload,
        aliases=frozenset(known - {""}),
        container=container["name"],
        scripts=SCRIPTS_PATH in mounts,
        phase="Terminating" if is_ending(item) else status.get("phase", "Unknown"),
        created=meta.get("creationTimestamp", ""),
        ready=is_ready(item),
        ros_name=ros_name,
        machine=item["spec"].get("nodeName", ""),
        restarts=restarts_of(status, container["name"]),
        helper=(meta.get("labels") or {}).get(COMPONENT_LABEL) == OBSERVABILITY,
    )


def restarts_of(status: dict[str, Any], container: str) -> int:
    """Return how often a container was restarted."""
    counts = {s["name"]: s["restartCount"] for s in status.get("containerStatuses") or []}
    return int(counts.get(container, 0))


def release_pods(found: Release) -> list[Pod]:
    """Return all pods of a release."""
    pods = (pod_of(item) for item in list_pods(found.cluster, found.id))
    return sorted(pods, key=lambda pod: (pod.workload, pod.created))


def choose_pods(found: Release, nodes: Sequence[str]) -> list[Pod]:
    """Return the pods of some ROS nodes, or of all.

    Raises:
        UserError: there is no such pod.
    """
    if nodes:
        return [pod for node in nodes for pod in pods_of(found, node)]
    chosen = [pod for pod in release_pods(found) if not pod.helper]
    if not chosen:
        raise no_pod_error(found)
    return chosen


def no_pod_error(found: Release) -> UserError:
    """Return the error for a release without pods."""
    return UserError(
        f"no pod of {found.id.name} is in the namespace {found.id.namespace}",
        hint="see what runs with `rigel status`, or choose another namespace with -n",
    )


def pods_of(found: Release, node: str) -> list[Pod]:
    """Return the pods of a ROS node, named by its key, its ROS name or its Kubernetes name.

    Raises:
        UserError: no pod of the release is of such a node.
    """
    everything = release_pods(found)
    if chosen := find_matching(everything, node):
        return chosen
    raise no_node_error(found, node, everything)


def no_node_error(found: Release, node: str, pods: Sequence[Pod]) -> UserError:
    """Return the error for a name that is not one of a release's nodes."""
    names = sorted({pod.workload for pod in pods})
    if not names:
        return no_pod_error(found)
    close = find_nearest(node, names)
    meant = f', did you mean "{close}"?' if close else ""
    return UserError(f'no pod of a node "{node}"{meant}', hint=f"its nodes are: {', '.join(names)}")


def find_matching(pods: Sequence[Pod], node: str) -> list[Pod]:
    """Return the pods that a name means."""
    chosen = [pod for pod in pods if node in pod.aliases]
    return chosen or [pod for pod in pods if pod.workload == object_name(node)]


def choose_running(pods: Sequence[Pod]) -> Pod:
    """Return the pod to work in: a ready one, else the youngest that runs.

    Raises:
        UserError: none runs.
    """
    alive = [pod for pod in pods if pod.phase == "Running"]
    if not alive:
        raise UserError(
            f"no pod of {pods[0].workload} runs: {pods[-1].name} is {pods[-1].phase}",
            hint="see why with `rigel status`",
        )
    return max(alive, key=lambda pod: (pod.ready, pod.created))


def execute(
    settings: Settings,
    node: str,
    command: Sequence[str],
    *,
    stdin: BinaryIO | None,
    stdout: BinaryIO,
    stderr: BinaryIO,
    tty: bool,
    job: str | None = None,
) -> int:
    """Run a command in a node's container with ROS set up; return its exit code.

    Without a command it is a shell. A container without our scripts gets the command unchanged.
    """
    found = release(settings, job, [node])
    with found.cluster as cluster:
        pod = choose_running(pods_of(found, node))
        return cluster.exec(
            pod.namespace,
            pod.name,
            wrap_command(pod, command),
            container=pod.container,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            tty=tty,
        )


def wrap_command(pod: Pod, command: Sequence[str]) -> list[str]:
    """Return what to run in a pod to have ROS set up."""
    if pod.scripts:
        return ["/bin/sh", f"{SCRIPTS_PATH}/exec.sh", *command]
    return list(command) or ["/bin/sh"]


def forward(
    settings: Settings, node: str, ports: dict[int, int], job: str | None = None
) -> Iterator[str]:
    """Forward local ports to a node's pod (remote -> local, 0 any); yield messages.

    Ends when it is closed.

    Raises:
        UserError: the pod has ended.
        ClusterError: the right is missing, which shows with the first connection.
    """
    found = release(settings, job, [node])
    with found.cluster as cluster:
        pod = choose_running(pods_of(found, node))
        with cluster.port_forward(pod.namespace, pod.name, ports) as opened:
            yield from (f"127.0.0.1:{lo} -> {pod.name}:{re}" for re, lo in opened.ports.items())
            reported = 0
            while True:
                time.sleep(LOOK)
                if opened.denied:
                    raise opened.denied
                if reported < len(opened.errors):
                    yield from opened.errors[reported:]
                    reported = len(opened.errors)
                    require_running(cluster, pod, node)


def require_running(cluster: Cluster, pod: Pod, node: str) -> None:
    """Raise if a pod has ended: connections to it can only fail from now on."""
    there = cluster.list("v1", "Pod", pod.namespace, fields=f"metadata.name={pod.name}")
    if not there or pod_of(there[0]).phase != "Running":
        raise UserError(f"the pod {pod.name} has ended", hint=f"run it again for {node}'s next pod")
