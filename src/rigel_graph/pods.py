"""A release's pods as far as a ROS graph needs them, and which node runs in which; pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_graph.discovery.members import has_layer, name_memory, ros_of_note
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_k8s.network.wiring import NETWORK_ANNOTATION, read_status
from rigel_k8s.objects.facts import has_ended, is_ending, is_ready, runs
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION, denies_ros
from rigel_k8s.objects.overlay import parse_json
from rigel_k8s.objects.podnodes import split_all
from rigel_k8s.objects.pods import MASTER_NAME, find_container
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.release.drift import describe_halt
from rigel_k8s.ros import Ros


@attrs.frozen
class GraphPod:
    """A pod of a release.

    Attributes:
        container: the one with the in-pod scripts, else the first.
        ros_name: what its annotation names, "" for none (a launch file's pod has several nodes).
        addresses: all that it has; they show which nodes are in it.
        running: its container runs.
        has_layer: its ROS 2 processes note what passes.
        memory: the pod or the machine whose memory Fast DDS uses in it, "" for none.
    """

    name: str
    namespace: str
    workload: str
    container: str
    machine: str = ""
    ros_name: str = ""
    ros: Ros = attrs.field(factory=lambda: ros_of_note({}))
    addresses: frozenset[str] = frozenset()
    ready: bool = False
    running: bool = False
    has_layer: bool = False
    memory: str = ""

    @property
    def key(self) -> str:
        """Differs for each node of a pod."""
        return f"{self.name}/{self.container}"

    @property
    def is_master(self) -> bool:
        """Whether roscore runs in it."""
        return self.workload == MASTER_NAME

    @property
    def is_exporter(self) -> bool:
        """Whether the ROS exporter runs in it."""
        return self.workload == EXPORTER


def read_pods(items: Iterable[Mapping[str, Any]]) -> tuple[GraphPod, ...]:
    """Return pods by name, one with several nodes for each; those that end are left out."""
    lasting = (item for item in split_all(items) if not (is_ending(item) or has_ended(item)))
    found = [read_pod(item) for item in lasting]
    return tuple(sorted(found, key=lambda pod: pod.key))


def read_pod(item: Mapping[str, Any]) -> GraphPod:
    """Return the values of a pod's manifest and status."""
    meta, spec, status = item["metadata"], item["spec"], item.get("status") or {}
    notes = meta.get("annotations") or {}
    own = find_container(spec) or spec["containers"][0]
    container = str(own["name"])
    return GraphPod(
        name=str(meta["name"]),
        namespace=str(meta["namespace"]),
        workload=str((meta.get("labels") or {}).get(NAME_LABEL, "")),
        container=container,
        ros=ros_of_note(parse_json(notes.get(NETWORK_ANNOTATION), {})),
        machine=str(spec.get("nodeName") or ""),
        ros_name=str(notes.get(ROS_NAME_ANNOTATION, "")),
        addresses=frozenset(list_addresses(notes, status)),
        ready=is_ready(dict(item)),
        running=runs(status, container),
        has_layer=has_layer(own),
        memory=name_memory(item, parse_json(notes.get(NETWORK_ANNOTATION), {})),
    )


def list_addresses(annotations: Mapping[str, str], status: Mapping[str, Any]) -> Iterator[str]:
    """Yield the addresses that Kubernetes and Multus gave a pod."""
    yield from (str(one["ip"]) for one in status.get("podIPs") or [] if one.get("ip"))
    if status.get("podIP"):
        yield str(status["podIP"])
    yield from (ip for _, ips in read_status(annotations) for ip in ips)


def expected_nodes(deployments: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Return the ROS names that Deployments promise, and the workload of each.

    A Deployment that the Rigelfile stops promises none, nor does a program without ROS.
    """
    found = {}
    kept = (one for one in deployments if one["spec"].get("replicas", 1) or describe_halt(one))
    for item in split_all(kept):
        notes = item["metadata"].get("annotations") or {}
        inner = item["spec"].get("template", {}).get("metadata", {}).get("annotations") or {}
        name = notes.get(ROS_NAME_ANNOTATION) or inner.get(ROS_NAME_ANNOTATION)
        note: dict[str, Any] = parse_json(inner.get(NETWORK_ANNOTATION), {})
        with_ros = not denies_ros(inner) and note.get("ros") != "none"
        if name and with_ros and not is_ending(item):
            found[str(name)] = str(item["metadata"]["name"])
    return found


def place_nodes(
    nodes: Iterable[GraphNode], pods: Sequence[GraphPod], expected: Mapping[str, str]
) -> tuple[GraphNode, ...]:
    """Return nodes with their pods and machines, and those that are expected and missing.

    A node is in the pod that is annotated with its name, else in the only one at its address. A pod
    whose program uses another name than the expected one does not count as missing.
    """
    made = [node if node.pod else place_node(node, pods) for node in nodes]
    names, workloads = {node.name for node in made}, {node.workload for node in made}
    for name, workload in expected.items():
        if name not in names and workload not in workloads:
            made.append(missing_node(name, workload, pods))
    return tuple(sorted(made, key=lambda node: node.name))


def place_node(node: GraphNode, pods: Sequence[GraphPod]) -> GraphNode:
    """Return a node with its pod; only with its machine if several pods share the address."""
    by_name = [pod for pod in pods if pod.ros_name == node.name]
    here = [pod for pod in pods if node.address and node.address in pod.addresses]
    found = by_name if len(by_name) == 1 else [pod for pod in by_name if pod in here] or here
    if len(found) == 1:
        (pod,) = found
        return attrs.evolve(
            node, pod=pod.name, workload=pod.workload, machine=pod.machine, ready=pod.ready
        )
    machines = {pod.machine for pod in here}
    return attrs.evolve(node, machine=machines.pop() if len(machines) == 1 else "")


def mark_shared(
    graph: RosGraph, nodes: Iterable[GraphNode], pods: Iterable[GraphPod]
) -> tuple[GraphTopic, ...]:
    """Return a graph's topics with the pairs of nodes whose messages go by shared memory."""
    memory = {(pod.name, pod.workload): pod.memory for pod in pods}
    of_node = {node.name: memory.get((node.pod, node.workload), "") for node in nodes}
    return tuple(
        attrs.evolve(
            topic,
            shared=tuple(
                (one, other)
                for one in topic.publishers
                for other in topic.subscribers
                if one != other and of_node.get(one) and of_node[one] == of_node.get(other)
            ),
        )
        for topic in graph.topics
    )


def find_leaving(items: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return the names of nodes whose pods are being terminated.

    Their addresses are not enough: if another process has taken a node's name, the master has the
    new process' address, and the old process' topics until that process unregisters them.

    Args:
        items: all pods of the release, as the API server returns them.
    """
    ending = [read_pod(item) for item in split_all(items) if is_ending(item)]
    return tuple(sorted({pod.ros_name or pod.workload for pod in ending}))


def missing_node(name: str, workload: str, pods: Sequence[GraphPod]) -> GraphNode:
    """Return a node that is expected and not in the graph, at the pod that should run it."""
    pod = next((pod for pod in pods if pod.workload == workload), None)
    return GraphNode(
        name,
        workload=workload,
        machine=pod.machine if pod else "",
        pod=pod.name if pod else "",
        ready=bool(pod and pod.ready),
        registered=False,
        up=False,
    )
