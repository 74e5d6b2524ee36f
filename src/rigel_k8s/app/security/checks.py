"""What a Rigelfile requests that `security: restricted` does not allow; pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rigel_k8s.app.mounts import device_of, mount_of
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.network.mode import mode_path
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.podsecurity import find_in_context, find_violations
from rigel_k8s.objects.raw import pod_of
from rigel_k8s.problems import Path, Problem

LEVEL = "security: restricted"
POD = ("spec", "template", "spec")
NETWORK = (
    "security: restricted does not allow the machine's own network: choose another mode, or remove"
    " `security`"
)
HOST_PATH = (
    "security: restricted does not allow directories and files of the machine: use one of"
    " persistent_storage.volumes, or remove `security`"
)
DEVICE = (
    "security: restricted does not allow device files: use a device plugin and `resource:"
    " squat.ai/NAME`, or remove `security`"
)
OWNER = (
    "Kubernetes does not change the owner of a machine's directory: user {user} must be able to"
    " write to {path} there (`chown {user} {path}` on the machine)"
)


def check_security(options: OrchestrationOptions) -> Iterator[Problem]:
    """Yield what the level "restricted" does not allow, with the option that requests it."""
    if options.security is None:
        return
    if options.network is not None and mode_of(options.network).in_machine_network:
        yield Problem(mode_path(options.network), NETWORK, "restricted", at_key=True)
    for key, node in options.nodes.items():
        yield from (problem.under(("nodes", str(key))) for problem in check_node(node))
    params = options.additional_k8s_params
    for name, tree in (("ros_master", params.ros_master), ("application", params.application)):
        yield from find_in_patch(("additional_k8s_params", name), tree)
    for index, volume in enumerate(options.persistent_storage.volumes):
        if volume.host_path:
            message = OWNER.format(user=int(options.security.user), path=volume.host_path)
            place = ("persistent_storage", "volumes", index, "host_path")
            yield Problem(place, message, "volume-owner", severity="warning", at_key=True)


def check_node(node: NodeOptions) -> Iterator[Problem]:
    """Yield what a node requests that is not allowed; paths are the node's own."""
    if node.host_network:
        message = NETWORK.replace("choose another mode", "remove `host_network`")
        yield Problem(("host_network",), message, "restricted", at_key=True)
    for path, what in find_in_context(node.security_context):
        yield refuse(("security_context", *path), what)
    for index, mount in enumerate(map(mount_of, node.volumes)):
        if mount.host_path:
            yield Problem(("volumes", index), HOST_PATH, "restricted")
    for index, device in enumerate(map(device_of, node.devices)):
        if device.path:
            yield Problem(("devices", index), DEVICE, "restricted")
    yield from find_in_patch(("patch",), node.patch)


def find_in_patch(path: Path, tree: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what a patch of a Deployment requests that is not allowed."""
    for below, what in find_violations(pod_of(tree)):
        yield refuse((*path, *POD, *below), what)


def refuse(path: Path, what: str) -> Problem:
    """Return the problem of a value that the level does not allow."""
    message = f"{LEVEL} does not allow {what}: remove one of the two"
    return Problem(path, message, "restricted", at_key=True)
