"""Which pods of a release take part in DDS, and what each of them should have; pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.network.modes import mode_named
from rigel_k8s.network.wiring import NETWORK_ANNOTATION, read_status
from rigel_k8s.objects.facts import has_ended, is_ending, is_out_of_reach, is_ready, runs
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.naming import denies_ros
from rigel_k8s.objects.overlay import parse_json
from rigel_k8s.objects.podnodes import shared_pod, split_all
from rigel_k8s.objects.pods import SCRIPTS_PATH, find_container
from rigel_k8s.ros import BY_NAME, ROS_1, Ros

#: Variables that a user may set in a pod without `network`: then discovery does not use multicast.
OWN_WAYS = (
    "ROS_DISCOVERY_SERVER",
    "ROS_STATIC_PEERS",
    "CYCLONEDDS_URI",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
)
#: The variable of a container whose ROS 2 processes have the layer: where they write their notes.
NOTES = "RIGEL_RMW"
PROBE = f"{SCRIPTS_PATH}/ready.sh"


@attrs.frozen
class Member:
    """One pod that takes part, from its manifest and its status; of several nodes, one of each.

    Attributes:
        pod: its name, as POD/NODE if other nodes are in it.
        workload: the name of its Deployment.
        machine: the Kubernetes node that it runs on.
        domain: the DDS domain that it should be in, None if the image decides.
        interface: the one that DDS should use, None for all.
        address: the interface's, from the Rigelfile or from Multus; None if neither sets it.
        servers: its discovery servers, HOST:PORT.
        own_ways: variables by which a user configures its discovery without `network`.
        running: whether its container runs, so it can be examined.
        reachable: whether its machine reports to Kubernetes.
        probed: whether it has our readiness probe; if a user set another one, or none, its
            program need not use DDS.
        has_layer: whether its ROS 2 processes note what passes.
        memory: the pod or the machine whose memory Fast DDS uses in it, "" for none.
        ready: whether its pod is ready; with peers, its name leads to it only then.
    """

    namespace: str
    pod: str
    workload: str
    machine: str
    container: str
    mode: str
    domain: int | None
    middleware: str
    interface: str | None
    address: str | None
    ip: str
    servers: tuple[str, ...]
    own_ways: tuple[str, ...]
    running: bool
    reachable: bool = True
    probed: bool = True
    has_layer: bool = False
    memory: str = ""
    ready: bool = True

    @property
    def name(self) -> str:
        """The pod's name."""
        return self.pod.partition("/")[0]


def members(pods: Iterable[Mapping[str, Any]]) -> list[Member]:
    """Return the pods that take part, by name; those that are ending or have ended do not."""
    parts = split_all(pods)
    found = (member_of(pod) for pod in parts if not (is_ending(pod) or has_ended(pod)))
    return sorted((one for one in found if one), key=lambda one: one.pod)


def member_of(pod: Mapping[str, Any]) -> Member | None:
    """Return a pod as a member, None if it does not take part."""
    meta, spec, status = pod["metadata"], pod.get("spec") or {}, pod.get("status") or {}
    annotations = meta.get("annotations") or {}
    note: dict[str, Any] = parse_json(annotations.get(NETWORK_ANNOTATION), {})
    container = find_container(spec)
    if "mode" not in note or container is None or not ros_of_note(note).dds:
        return None
    if denies_ros(annotations):  # beside ROS nodes: its DDS is not checked
        return None
    shared, mode = shared_pod(pod), mode_named(str(note["mode"]))
    env = {e["name"]: str(e.get("value") or "") for e in container.get("env") or []}
    interface = note.get("interface")
    return Member(
        namespace=str(meta["namespace"]),
        pod=f"{meta['name']}/{container['name']}" if shared else str(meta["name"]),
        workload=shared or str((meta.get("labels") or {}).get(NAME_LABEL, meta["name"])),
        machine=str(spec.get("nodeName") or ""),
        container=str(container["name"]),
        mode=str(note["mode"]),
        domain=note["domain"] if isinstance(note.get("domain"), int) else None,
        middleware=str(note.get("middleware") or mode.middleware or ""),
        interface=str(interface) if interface else None,
        address=choose_address(note, annotations, interface),
        ip=str(status.get("podIP") or ""),
        servers=tuple(filter(None, env.get("ROS_DISCOVERY_SERVER", "").split(";"))),
        own_ways=tuple(v for v in OWN_WAYS if env.get(v)) if not mode.connects else (),
        running=runs(status, str(container["name"])),
        reachable=not is_out_of_reach(pod),
        probed=PROBE in probe_words(container),
        has_layer=has_layer(container),
        memory=name_memory(pod, note),
        ready=is_ready(pod),
    )


def name_memory(pod: Mapping[str, Any], note: Mapping[str, Any]) -> str:
    """Return whose memory a pod's programs share: the pod's, or their machine's; "" for none."""
    if not note.get("shared_memory"):
        return ""
    machine = str((pod.get("spec") or {}).get("nodeName") or "")
    of_machine = mode_named(str(note.get("mode"))).in_machine_network
    return f"machine {machine}" if of_machine else f"pod {pod['metadata']['name']}"


def ros_of_note(note: Mapping[str, Any]) -> Ros:
    """Return which ROS a pod's network annotation names; a pod of ROS 1 has none."""
    return BY_NAME.get(str(note.get("ros")), ROS_1)


def choose_address(
    note: Mapping[str, Any], annotations: Mapping[str, str], interface: str | None
) -> str | None:
    """Return the address in our annotation, or else the first of IPv4 in Multus' annotation."""
    if note.get("address"):
        return str(note["address"]).partition("/")[0]
    noted = read_status(annotations) if interface else ()
    found = (ip for name, ips in noted if name == interface for ip in ips if ":" not in ip)
    return next(found, None)


def probe_words(container: Mapping[str, Any]) -> Sequence[str]:
    """Return the command of a container's readiness probe."""
    probe = container.get("readinessProbe") or {}
    return (probe.get("exec") or {}).get("command") or ()


def has_layer(container: Mapping[str, Any]) -> bool:
    """Whether the ROS 2 processes of a container note what passes."""
    return any(one["name"] == NOTES for one in container.get("env") or [])
