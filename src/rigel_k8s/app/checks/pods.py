"""What is wrong with nodes that share a pod, which is a `pod` of theirs; pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rigel_k8s.app.environment import find_literal
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.layer import SHM_PATH
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.volumes import find_mounts
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.podoptions import PortOptions
from rigel_k8s.problems import Problem

#: Options that a pod has once.
OF_THE_POD = (
    *("placement", "tolerations", "host_network", "runtime_class", "service_account", "labels"),
    *("termination_grace_period", "patch"),
)


def group_nodes(options: OrchestrationOptions) -> dict[str, list[str]]:
    """Return the keys of nodes by their `pod`."""
    found: dict[str, list[str]] = {}
    for key, node in options.nodes.items():
        if node.pod:
            found.setdefault(str(node.pod), []).append(str(key))
    return found


def check_pods(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong, with paths from the root of the options."""
    for pod, keys in group_nodes(options).items():
        refused = list(refuse_nodes(options, ros, keys))
        yield from refused
        if not refused:
            yield from compare_nodes(options.nodes, pod, keys)
            yield from check_participants(options, pod, keys)
            yield from warn_of_pod(pod, keys)
            yield from warn_of_machine(options, keys[0])


def refuse_nodes(
    options: OrchestrationOptions, ros: Generation, keys: list[str]
) -> Iterator[Problem]:
    """Yield nodes that cannot share a pod, or what they cannot have in it."""
    for key in keys:
        node, path = options.nodes[key], ("nodes", key)
        for name, is_wrong, message in (
            ("pod", not ros.of_node(node).rmw, "only nodes of ROS 2 have `pod`: remove it"),
            (
                "anonymous",
                node.anonymous,
                "a node with `pod` has one name, and one pod: remove one of the two",
            ),
            (
                "replicas",
                node.replicas is not None,
                "a node with `pod` has one pod: remove one of the two",
            ),
        ):
            if is_wrong:
                yield Problem((*path, name), message, "pod-node", at_key=True)
        for index, other in enumerate(node.placement.apart_from):
            if other in keys:
                message = f'"{other}" is in the same pod: remove one of the two'
                yield Problem((*path, "placement", "apart_from", index), message, "pod-node")
        for index in find_mounts(node.volumes, SHM_PATH):
            message = f"the nodes of a pod have one {SHM_PATH} in common: remove this volume"
            yield Problem((*path, "volumes", index), message, "pod-node")


def compare_nodes(nodes: Mapping[str, NodeOptions], pod: str, keys: list[str]) -> Iterator[Problem]:
    """Yield what differs in the nodes of a pod, and must not; and what must differ."""
    first, *others = keys
    wanted, ports = list_properties(nodes[first]), list_ports(nodes[first])
    for key in others:
        found = list_properties(nodes[key])
        for name in (name for name in wanted if wanted[name] != found[name]):
            message = (
                f'"{first}" and "{key}" share the pod "{pod}", which has one `{name}`: set the same'
                " at both"
            )
            path = ("nodes", key, name.partition(".")[0])
            yield Problem(path, message, "pod-conflict", at_key=True)
        for port in sorted(ports & list_ports(nodes[key])):
            message = f'another node of the pod "{pod}" has the port {port}: choose another one'
            yield Problem(("nodes", key, "ports"), message, "pod-conflict", at_key=True)
        ports |= list_ports(nodes[key])


def list_properties(node: NodeOptions) -> dict[str, Any]:
    """Return what a pod has once."""
    update = node.update
    own: dict[str, Any] = {key: getattr(node, key) for key in OF_THE_POD}
    own["update.strategy"] = ((update and update.strategy) or "HandOver").lower()  # the default
    for key in ("max_surge", "max_unavailable"):
        own[f"update.{key}"] = getattr(update, key) if update else None
    return own | {"env.ROS_DOMAIN_ID": find_literal(node.env, "ROS_DOMAIN_ID")}


def list_ports(node: NodeOptions) -> set[int]:
    return {int(one.port if isinstance(one, PortOptions) else one) for one in node.ports}


def check_participants(
    options: OrchestrationOptions, pod: str, keys: list[str]
) -> Iterator[Problem]:
    """Yield a pod with more nodes than other pods look for."""
    most = mode_of(options.network).participants
    if most is not None and len(keys) > most:
        message = (
            f"with `{mode_of(options.network).name}` other pods find {most} participants of a pod,"
            f' and "{pod}" has {len(keys)} nodes: make two pods of it, or use another mode'
        )
        yield Problem(("nodes", keys[most], "pod"), message, "many-participants", at_key=True)


def warn_of_pod(pod: str, keys: list[str]) -> Iterator[Problem]:
    """Yield what nodes give up that share a pod."""
    if len(keys) > 1:
        message = (
            f"{', '.join(keys)} share one pod: they run on one machine, a change of one of"
            " them replaces all, and one that does not become ready holds up the update of all"
        )
        yield Problem(
            ("nodes", keys[0], "pod"), message, "one-pod", severity="warning", at_key=True
        )


def warn_of_machine(options: OrchestrationOptions, key: str) -> Iterator[Problem]:
    """Yield a pod that shares no memory: its address is that of other pods of its machine, too."""
    network = options.network
    on_machine = options.nodes[key].host_network or mode_of(network).in_machine_network
    if on_machine and not (network and network.shared_memory):
        message = (
            "a pod on its machine's own network shares no memory, since its address is also that of"
            " other pods: use another network, or `network: {mode: host, shared_memory: true}`"
        )
        yield Problem(("nodes", key, "pod"), message, "no-memory", severity="warning", at_key=True)


def name_obstacle(obstacles: Mapping[str, str | None], key: str) -> str | None:
    """Return why a node cannot be handed over: its own reason, or another one's of its pod.

    Args:
        obstacles: of the nodes of the pod, by key.
    """
    if obstacles[key]:
        return obstacles[key]
    return next((f"{other}: {why}" for other, why in obstacles.items() if why), None)


def pod_names(options: OrchestrationOptions) -> dict[str, str]:
    """Return the names on Kubernetes that pods of several nodes take, and what messages call it."""
    return {object_name(pod): f'the pod "{pod}"' for pod in group_nodes(options)}
