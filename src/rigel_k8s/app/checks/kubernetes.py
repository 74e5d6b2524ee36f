"""What only Kubernetes would refuse of a node: mounts, ports, resources, rights; paths are its own.

Kubernetes would name a field of a Deployment that the user has not written.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

from rigel_k8s.app.checks.schema import Place, check_value
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.layer import NOTES_PATH
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH
from rigel_k8s.app.volumes import device_of, mount_of, mount_path
from rigel_k8s.network.dds import FILES_PATH
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import INTERFACE, Network
from rigel_k8s.network.wiring import NETWORKS_ANNOTATION
from rigel_k8s.objects.overlay import containers_of, find_below, mapping
from rigel_k8s.objects.podoptions import OUTSIDE, PortOptions, Volume
from rigel_k8s.objects.pods import LOG_PATH, SCRIPTS_PATH
from rigel_k8s.option_text import has_template, text_of
from rigel_k8s.problems import Path, Problem
from rigel_k8s.rigelfile import find_nearest

#: What Kubernetes has without a domain in its name.
RESOURCES = ("cpu", "memory", "ephemeral-storage")
#: Parts of a securityContext that contradict each other.
EXCLUSIVE = (
    (("privileged", True), ("allowPrivilegeEscalation", False)),
    (("runAsNonRoot", True), ("runAsUser", 0)),
)
#: What a variable may have of its pod.
FIELDS = (
    *("status.podIP", "status.podIPs", "status.hostIP", "status.hostIPs", "metadata.name"),
    *("metadata.namespace", "metadata.uid", "spec.nodeName", "spec.serviceAccountName"),
)
FIELD_PATH = re.compile(
    rf"{'|'.join(map(re.escape, FIELDS))}|metadata\.(labels|annotations)\['.+'\]"
)


def check_kubernetes(
    node: NodeOptions, options: OrchestrationOptions, ros: Generation
) -> Iterator[Problem]:
    """Yield what Kubernetes would refuse, or what would not start."""
    volumes = {str(volume.name): volume for volume in options.persistent_storage.volumes}
    ours = dict.fromkeys((SCRIPTS_PATH, LOG_PATH, PARAMETERS_PATH, FILES_PATH, NOTES_PATH))
    if ros.dds and has_own_machine_id(options.network, options.middleware):
        ours["/etc/machine-id"] = None
    yield from check_mounts(node, volumes, set(ours))
    yield from check_ports(node)
    yield from check_service_type(node, options.network)
    yield from check_resource_names(node)
    yield from check_tolerations(node)
    yield from check_raw(node)
    yield from check_attachments(node, options.network)


def check_attachments(node: NodeOptions, network: Network | None) -> Iterator[Problem]:
    """Yield a patch that takes the pod's second interface away."""
    above = ("spec", "template", "metadata", "annotations")
    asked = find_below(node.patch, (*above, NETWORKS_ANNOTATION))
    if mode_of(network).attached and asked is not None and INTERFACE not in str(asked):
        message = f"it replaces the release's own attachment, so the pod has no {INTERFACE}"
        yield Problem(("patch", *above, NETWORKS_ANNOTATION), message, "conflict", at_key=True)


def has_own_machine_id(network: Network | None, middleware: str | None) -> bool:
    """Return whether the network gives each pod an /etc/machine-id; see network/files.py."""
    if network is None or middleware not in (None, "fastdds"):
        return False
    mode = mode_of(network)
    return mode.attached or (mode.in_machine_network and network.interface is not None)


def check_mounts(
    node: NodeOptions, volumes: Mapping[str, Volume], ours: set[str]
) -> Iterator[Problem]:
    """Yield paths with two mounts, and paths inside of a volume that lead out of it.

    Args:
        volumes: the release's persistent volumes, by name.
        ours: the paths that rigel mounts.
    """
    taken: dict[str, str] = {"/": "the image"} | dict.fromkeys(ours, "rigel itself")
    for at in map(str, node.files):
        yield from claim_path(at, ("files", at), taken)
    for index, mount in enumerate(map(mount_of, node.volumes)):
        path: Path = ("volumes", index)
        volume = volumes.get(str(mount.name))
        at = str(mount.mount_path or (mount_path(volume) if volume else ""))
        yield from claim_path(at, path, taken)
        inner = PurePosixPath(mount.sub_path or "")
        if inner.is_absolute() or ".." in inner.parts:
            message = f'"{mount.sub_path}" leads out of the volume: write a path inside of it'
            yield Problem((*path, "sub_path"), message, "bad-path")
    for index, device in enumerate(map(device_of, node.devices)):
        if device.path and not device.resource:
            at = str(device.mount_path or device.path.inside)
            yield from claim_path(at, ("devices", index), taken)


def claim_path(at: str, path: Path, taken: dict[str, str]) -> Iterator[Problem]:
    """Yield that a path has another mount; else it is taken from now on."""
    at = at.rstrip("/") or at
    if not at or has_template(at):
        return
    if owner := taken.get(at):
        message = f"{at} already has a mount, of {owner}: choose another path, or remove one"
        yield Problem(path, message, "conflict")
    taken.setdefault(at, ".".join(map(str, path)))


def check_ports(node: NodeOptions) -> Iterator[Problem]:
    """Yield ports and names that a Service would have twice."""
    numbers: set[tuple[int, str]] = set()
    names: set[str] = set()
    for index, item in enumerate(node.ports):
        port = item if isinstance(item, PortOptions) else PortOptions(port=item)
        number = (int(port.service_port or port.port), port.protocol)
        name = str(port.name or f"{port.protocol.lower()}-{int(port.port)}")
        if number in numbers:
            message = f"the port {number[0]} ({number[1]}) is there twice: remove one, or set"
            yield Problem(("ports", index), f"{message} `service_port`", "conflict")
        elif name in names:
            message = f'another port has the name "{name}": choose another `name`'
            yield Problem(("ports", index), message, "conflict")
        numbers.add(number)
        names.add(name)


def check_service_type(node: NodeOptions, network: Network | None) -> Iterator[Problem]:
    """Yield a type of a Service without a Service, or for what is reached without it."""
    if node.service_type is None:
        return
    mode = mode_of(network)
    if not node.ports:
        message = "a Service is made of `ports`: add them, or remove `service_type`"
        yield Problem(("service_type",), message, "incomplete", at_key=True)
    elif node.service_type in OUTSIDE and (node.host_network or mode.in_machine_network):
        message = "the node's ports are ports of its machine already: remove `service_type`"
        yield Problem(("service_type",), message, "reachable", severity="warning", at_key=True)
    elif node.service_type in OUTSIDE and mode.attached:
        message = (
            "the second network reaches the node at its address there: remove `service_type`,"
            " unless it is needed from elsewhere"
        )
        yield Problem(("service_type",), message, "reachable", severity="warning", at_key=True)


def check_resource_names(node: NodeOptions) -> Iterator[Problem]:
    """Yield resources that do not exist: others than Kubernetes' own have a domain."""
    for key in ("requests", "limits"):
        for name in map(str, getattr(node.resources, key)):
            if "/" in name or name in RESOURCES or name.startswith("hugepages-"):
                continue
            known = (*RESOURCES, "nvidia.com/gpu")
            near = known[-1] if name.lower() == "gpu" else find_nearest(name, known)
            hint = (
                f', did you mean "{near}"?' if near else ": it has a domain, as in squat.ai/serial"
            )
            message = f'"{name}" is not a resource of Kubernetes{hint}'
            yield Problem(("resources", key, name), message, "bad-resource", at_key=True)


def check_tolerations(node: NodeOptions) -> Iterator[Problem]:
    """Yield tolerations that Kubernetes refuses."""
    for index, one in enumerate(node.tolerations):
        message = ""
        if one.operator == "Exists" and one.value:
            message = "`Exists` has no `value`: remove one of the two"
        elif one.key is None and (one.value or one.operator == "Equal"):
            message = "`value` is that of a `key`: add it"
        elif one.seconds is not None and one.effect != "NoExecute":
            message = "`seconds` are for NoExecute: add `effect: NoExecute`"
        if message:
            yield Problem(("tolerations", index), message, "bad-toleration")


def check_raw(node: NodeOptions) -> Iterator[Problem]:
    """Yield what is wrong with what a node has of Kubernetes' own objects."""
    context = Place(("security_context",), "a securityContext")
    yield from check_value(node.security_context, "SecurityContext", context)
    for index, one in enumerate(node.env if isinstance(node.env, list) else ()):
        path: Path = ("env", index, "valueFrom")
        if one.value_from is None:
            continue
        yield from check_value(one.value_from, "EnvVarSource", Place(path, "valueFrom", whole=True))
        if len(one.value_from) != 1 or one.value is not None:
            message = "a variable has one source: `value`, or one key of `valueFrom`"
            yield Problem(path, message, "conflict", at_key=True)
        field = mapping(one.value_from.get("fieldRef")).get("fieldPath")
        if isinstance(field, str) and not FIELD_PATH.fullmatch(field) and not has_template(field):
            near = find_nearest(field, FIELDS) or FIELDS[0]
            message = f'a variable cannot have the field "{field}", did you mean "{near}"?'
            yield Problem((*path, "fieldRef", "fieldPath"), message, "bad-field")
    yield from check_context(("security_context",), node.security_context)
    for index, container in enumerate(containers_of(node.patch)):
        path = ("patch", "spec", "template", "spec", "containers", index, "securityContext")
        yield from check_context(path, mapping(container.get("securityContext")))


def check_context(path: Path, context: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield parts of a securityContext that contradict each other, and names that are none."""
    for (key, value), (other, refused) in EXCLUSIVE:
        if context.get(key) is value and context.get(other) == refused:
            message = f"with `{key}: {text_of(value)}` Kubernetes does not start it: remove one"
            yield Problem((*path, other), message, "conflict", at_key=True)
    for key in ("add", "drop"):
        listed = find_below(context, ("capabilities", key))
        for index, name in enumerate(listed if isinstance(listed, list) else ()):
            if str(name).upper().startswith("CAP_"):
                message = f"Kubernetes' names have no CAP_: write {str(name)[4:].upper()}"
                yield Problem((*path, "capabilities", key, index), message, "bad-name")
