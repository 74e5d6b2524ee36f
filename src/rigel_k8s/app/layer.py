"""The layer in a pod of ROS 2: a library in the node's processes, and the keeper beside them.

rmw.sh starts the program with both; what they do is in docs/ros2-updates.md and in
src/rigel_inpod/README.md. A pod that hands over also knows how to reach the workload's other pods.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from zlib import crc32

import attrs

from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.updating import Candidate
from rigel_k8s.objects.naming import object_name, selector
from rigel_k8s.objects.overlay import list_mappings, pod_of
from rigel_k8s.objects.podoptions import RollingUpdate
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.workloads import ReleaseContext

#: A directory for each container, in memory: a robot's disk is not written, and none survives.
NOTES_PATH = "/run/rigel-k8s"
#: A process notes 1.5 MB if it has as many topics as there is place for.
NOTES_SIZE = "64Mi"
#: The first of the keeper's four ports. Pods on one machine's network share its ports, and nodes
#: of one pod those of the pod, so each node there has four of some thousands, below NodePorts'.
KEEPER_PORT, KEEPER_PORTS = 11399, range(20_000, 30_000, 4)
#: Of nodes with one `pod`: where Fast DDS keeps messages, and how large they may be in total.
SHM_PATH, SHARED_MEMORY = "/dev/shm", "512Mi"  # POSIX' name
#: Seconds that goals of actions have to end.
DRAIN = 300
NOT_BUILT = "this installation of rigel was built without ziglang, so it has no library of ROS 2"


def choose_layer(node: NodeOptions, options: OrchestrationOptions) -> NodeOptions:
    """Return a node with the job's `rmw_layer` if it has none of its own."""
    return attrs.evolve(node, rmw_layer=options.rmw_layer) if node.rmw_layer is None else node


def explain_left_out(node: NodeOptions, line: Sequence[str]) -> str | None:
    """Return why the layer is not loaded into a node's program, None if it is.

    Args:
        line: what the node runs; empty for the image's CMD.
    """
    if node.rmw_layer is False:
        return "`rmw_layer` is false"
    if not line:
        return "it runs the image's CMD, which the library cannot be loaded into: set `args`"
    if node.command is None and str(line[0]).startswith("-"):
        return "its args are read by the image's ENTRYPOINT: set `command`"
    for container in list_mappings(pod_of(node.patch).get("containers")):
        if container.get("command") or container.get("args"):
            return "its patch sets what its container runs: use `args` or `command`"
    return None


def notes_volume() -> tuple[Object, Object]:
    """Return (volume, mount) of what the layer notes; it counts as the container's memory."""
    memory = {"medium": "Memory", "sizeLimit": NOTES_SIZE}
    mount = {"name": "rigel-notes", "mountPath": NOTES_PATH}
    return {"name": "rigel-notes", "emptyDir": memory}, mount


def layer_variables(container: str, port: int) -> dict[str, Object]:
    """Return the variables for a container's directory and its keeper's port."""
    found: dict[str, Object] = {"RIGEL_RMW": {"value": f"{NOTES_PATH}/{container}"}}
    if port != KEEPER_PORT:
        found["RIGEL_K8S_PEERS_PORT"] = {"value": str(port)}
    return found


def choose_port(release: ReleaseContext, node: str, *, shares_network: bool) -> int:
    """Return the first of the ports of a node's keepers.

    Args:
        shares_network: other nodes have the same address, that of its machine or of its pod.
    """
    if not shares_network:
        return KEEPER_PORT
    name = f"{release.namespace}/{release.release}/{node}"
    return KEEPER_PORTS[crc32(name.encode()) % len(KEEPER_PORTS)]


def hand_over_variables(candidate: Candidate) -> dict[str, Object]:
    """Return the variables by which a keeper finds those of the workload's other pods."""
    release, workload, update = candidate.release, candidate.workload, candidate.update
    name = {"apiVersion": "v1", "fieldPath": "metadata.name"}
    found: dict[str, Object] = {
        "RIGEL_K8S_WORKLOAD": {"value": f"{release.namespace}/{release.release}/{workload}"},
        "RIGEL_K8S_POD": {"valueFrom": {"fieldRef": name}},
        "RIGEL_K8S_PEERS": {"value": pods_name(workload)},
        "RIGEL_K8S_DRAIN": {"value": str(drain_seconds(update))},
    }
    if update.warm:
        namespace = (candidate.ros_name or "").rpartition("/")[0]
        topics = [str(t) if t.startswith("/") else f"{namespace}/{t}" for t in update.warm]
        found["RIGEL_RMW_WARM"] = {"value": ":".join(topics)}
    return found


def shared_pod_variables(workload: str, containers: Iterable[str]) -> dict[str, Object]:
    """Return the variables of a keeper with others in its pod: all take over together."""
    together = ":".join(containers)
    return {
        "RIGEL_K8S_PEERS": {"value": pods_name(workload)},
        "RIGEL_K8S_TOGETHER": {"value": together},
    }


def shared_memory() -> tuple[Object, Object]:
    """Return (volume, mount) of the memory that the nodes of a pod share; it counts as theirs."""
    memory = {"medium": "Memory", "sizeLimit": SHARED_MEMORY}
    mount = {"name": "rigel-shm", "mountPath": SHM_PATH}
    return {"name": "rigel-shm", "emptyDir": memory}, mount


def drain_seconds(update: RollingUpdate) -> int:
    """Return how long goals of actions may take to end."""
    return DRAIN if update.drain is None else max(1, round(update.drain.seconds))


def pods_name(workload: str) -> str:
    """Return the name of the Service whose addresses are those of all pods of a workload."""
    return object_name(f"{workload}-pods")


def pods_service(release: ReleaseContext, workload: str, ports: Sequence[int]) -> Object:
    """Return that Service: a name in DNS, on the pod network, that has pods before they are ready.

    Keepers find each other by it, and the exporter finds them. That of mode `peers` has one
    address, and leads to ready pods only.
    """
    return {
        "apiVersion": "v1",
        "kind": "Service",
        "metadata": release.metadata(pods_name(workload), part_of=workload),
        "spec": {
            "clusterIP": "None",
            "publishNotReadyAddresses": True,
            "selector": selector(workload),
            "ports": [
                {"name": f"keeper-{i}" if i else "keeper", "port": port, "targetPort": port}
                for i, port in enumerate(ports)
            ],
        },
    }
