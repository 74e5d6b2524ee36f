"""exec and forward, and how the pods of a ROS node are found."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import attrs

from rigel_k8s.app.foxglove import PORT_NAME
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import UserError
from rigel_k8s.kube import Cluster
from rigel_k8s.objects.facts import is_ending, is_ready
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.naming import NODE_ANNOTATION, ROS_NAME_ANNOTATION, object_name
from rigel_k8s.objects.podnodes import shared_pod, split_all
from rigel_k8s.objects.pods import SCRIPTS_PATH, scripts_config
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.pods import list_pods
from rigel_k8s.rigelfile import name_nearest
from rigel_k8s.settings import Settings

FOXGLOVE = str(PORT_NAME)
COMPONENT_LABEL, OBSERVABILITY = "app.kubernetes.io/component", "observability"
LOOK = 1.0  # seconds between two checks of a forward
#: Runs a command that ends when standard input does. Kubernetes leaves one alone whose caller has
#: gone, and a `ros2 topic echo` of a silent topic would stay in the pod as long as that runs.
TIED = (
    'exec 3<&0; "$@" 3<&- </dev/null & command=$!;'
    " (cat <&3; kill $command) >/dev/null 2>&1 & wait $command; code=$?; kill $!; exit $code"
)


@attrs.frozen
class Pod:
    """A pod of a release; one with several nodes is one for each of them.

    Attributes:
        workload: the Kubernetes name of its workload; of several nodes in one pod, the node's.
        node: its name in the Rigelfile, "" if it has none.
        aliases: all names that a user may use for its node.
        container: its first container.
        scripts: whether that has the in-pod scripts.
        machine: the machine, "" before it is scheduled.
        restarts: of its first container.
        helper: it is not a node of the application but watches them (the ROS exporter).
        shared: the name of the pod's workload if other nodes are in the pod, too, else "".
        once: a Job has made it, of a node that runs once.
        ports: the names of its first container's TCP ports, by number.
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
    node: str = ""
    ros_name: str = ""
    machine: str = ""
    restarts: int = 0
    helper: bool = False
    shared: str = ""
    once: bool = False
    ports: Mapping[int, str] = attrs.field(factory=dict, hash=False)

    @property
    def key(self) -> tuple[str, str]:
        """Differs for each node of a release and each of its pods."""
        return self.name, self.container

    @property
    def owner(self) -> ObjectRef:
        """The Job of its node, or the Deployment, which may have other nodes, too."""
        if self.once:
            return ObjectRef("batch/v1", "Job", self.namespace, self.workload)
        return ObjectRef("apps/v1", "Deployment", self.namespace, self.shared or self.workload)

    def find_deployment(self, done: str) -> ObjectRef:
        """Return the Deployment of its node; UserError if it runs once, and that cannot be done."""
        if self.once:
            raise UserError(
                f"{self.workload} runs once (kind: task), so it cannot be {done}",
                hint=f"`rigel restart {self.workload}` runs it again",
            )
        return self.owner


def pod_of(item: dict[str, Any]) -> Pod:
    """Return what we need from a pod object, or from a node's part of it."""
    meta, status = item["metadata"], item.get("status", {})
    notes = meta.get("annotations") or {}
    workload = (meta.get("labels") or {}).get(NAME_LABEL, "")
    ros_name = notes.get(ROS_NAME_ANNOTATION, "")
    container = item["spec"]["containers"][0]
    mounts = [mount["mountPath"] for mount in container.get("volumeMounts") or []]
    shared = shared_pod(item)
    node = notes.get(NODE_ANNOTATION, "")
    known = {meta["name"], workload, node, ros_name, ros_name[1:], shared}
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
        node=node,
        ros_name=ros_name,
        machine=item["spec"].get("nodeName", ""),
        restarts=restarts_of(status, container["name"]),
        helper=(meta.get("labels") or {}).get(COMPONENT_LABEL) == OBSERVABILITY,
        shared=shared,
        once=any(one.get("kind") == "Job" for one in meta.get("ownerReferences") or []),
        ports={
            port["containerPort"]: port.get("name", "")
            for port in container.get("ports") or []
            if port.get("protocol", "TCP") == "TCP"
        },
    )


def restarts_of(status: dict[str, Any], container: str) -> int:
    counts = {s["name"]: s["restartCount"] for s in status.get("containerStatuses") or []}
    return int(counts.get(container, 0))


def release_pods(found: Release) -> list[Pod]:
    pods = map(pod_of, split_all(list_pods(found.cluster, found.id)))
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
    meant = name_nearest(node, sorted({alias for pod in pods for alias in pod.aliases}))
    return UserError(f'no pod of a node "{node}"{meant}', hint=f"its nodes are: {', '.join(names)}")


def find_matching(pods: Sequence[Pod], node: str) -> list[Pod]:
    """Return the pods that a name means; without its namespace, it has to be the only such node."""
    chosen = [pod for pod in pods if node in pod.aliases]
    chosen = chosen or [pod for pod in pods if pod.workload == object_name(node)]
    last = [pod for pod in pods if pod.ros_name.rpartition("/")[2] == node]
    return chosen or (last if len({pod.workload for pod in last}) == 1 else [])


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

    Without a command it is a shell. A container without our scripts gets the command unchanged;
    elsewhere one without input ends with its caller.
    """
    found = release(settings, job, [node])
    with found.cluster as cluster:
        pod = choose_running(pods_of(found, node))
        words = wrap_command(pod, command)
        if stdin is None and pod.scripts:
            return run_tied(cluster, pod, words, stdout, stderr)
        return cluster.exec(
            pod.namespace,
            pod.name,
            words,
            container=pod.container,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            tty=tty,
        )


def run_tied(
    cluster: Cluster, pod: Pod, words: Sequence[str], stdout: BinaryIO, stderr: BinaryIO
) -> int:
    """Run a command that ends when this process does, and return its exit code."""
    silent, held = os.pipe()  # `held` stays open as long as this process runs the command
    try:
        with os.fdopen(silent, "rb") as stdin:
            return cluster.exec(
                pod.namespace,
                pod.name,
                ["/bin/sh", "-c", TIED, "sh", *words],
                container=pod.container,
                stdin=stdin,
                stdout=stdout,
                stderr=stderr,
            )
    finally:
        os.close(held)


def check_script(found: Release, script: str, what: str) -> None:
    """Raise UserError for a release of a version that had no such script in its pods.

    Args:
        what: cannot be done with its nodes: "developed".
    """
    ref = ObjectRef("v1", "ConfigMap", found.id.namespace, scripts_config(found.id.name))
    live = found.cluster.get(ref)
    if live is None or script not in live.get("data", {}):
        raise UserError(
            f"{found.id.name} was deployed by an older rigel-k8s, whose nodes cannot be {what}",
            hint="deploy it with `rigel run`",
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

    Without ports it is the node's only one. Ends when it is closed.

    Raises:
        UserError: the pod has ended, or which port is meant is not clear.
        ClusterError: the right is missing, which shows with the first connection.
    """
    found = release(settings, job, [node])
    with found.cluster as cluster:
        pod = choose_running(pods_of(found, node))
        with cluster.port_forward(pod.namespace, pod.name, ports or only_port(pod)) as opened:
            for remote, local in opened.ports.items():
                yield f"127.0.0.1:{local} -> {pod.name}:{remote}"
                if pod.ports.get(remote) == FOXGLOVE:
                    yield from address_viewers(f"ws://127.0.0.1:{local}")
            reported = 0
            while True:
                time.sleep(LOOK)
                if opened.denied:
                    raise opened.denied
                if reported < len(opened.errors):
                    yield from (explain_forward(text, node) for text in opened.errors[reported:])
                    reported = len(opened.errors)
                    require_running(cluster, pod, node)


def only_port(pod: Pod) -> dict[int, int]:
    """Return the port of a node that has one, as `forward` takes it; else raise UserError."""
    if len(pod.ports) == 1:
        return {port: port for port in pod.ports}
    known = ", ".join(map(str, pod.ports))
    raise UserError(
        f"{pod.workload} has the ports {known}" if known else f"{pod.workload} has no `ports`",
        hint=f"name the port: `rigel forward {pod.workload} PORT`",
    )


def address_viewers(url: str) -> Iterator[str]:
    """Yield where to see what the bridge of `foxglove` sends."""
    yield f"Foxglove: https://app.foxglove.dev/~/view?ds=foxglove-websocket&ds.url={url}"
    yield f"or open {url} in Lichtblick or another viewer"


def explain_forward(text: str, node: str) -> str:
    """Return an error of a forward in a few words if its cause is known."""
    refused = re.search(r"forwarding port (\d+) .*connection refused", text, re.DOTALL)
    return f"nothing listens on port {refused[1]} in {node}" if refused else text


def require_running(cluster: Cluster, pod: Pod, node: str) -> None:
    """Raise if a pod has ended: connections to it can only fail from now on."""
    there = cluster.list("v1", "Pod", pod.namespace, fields=f"metadata.name={pod.name}")
    if not there or pod_of(there[0]).phase != "Running":
        raise UserError(f"the pod {pod.name} has ended", hint=f"run it again for {node}'s next pod")
