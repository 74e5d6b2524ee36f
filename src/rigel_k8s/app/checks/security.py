"""What the level "restricted" of `security` does not allow in a job's options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.volumes import device_of, mount_of
from rigel_k8s.network.mode import mode_path
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.overlay import pod_of
from rigel_k8s.objects.podsecurity import find_in_context, find_violations
from rigel_k8s.problems import Path, Problem

POD = ("spec", "template", "spec")
OWN_NETWORK = "the machine's own network"
OWNER = (
    "Kubernetes does not change the owner of a machine's directory: user {user} must be able to"
    " write to {path} there (`chown {user} {path}` on the machine)"
)


def check_security(options: OrchestrationOptions) -> Iterator[Problem]:
    """Yield what the level "restricted" does not allow, with the option that requests it."""
    if options.security is None:
        return
    if options.network is not None and mode_of(options.network).in_machine_network:
        path = mode_path(options.network)
        yield refuse(path, OWN_NETWORK, "choose another mode, or remove `security`")
    for key, node in options.nodes.items():
        yield from (problem.under(("nodes", str(key))) for problem in check_node_security(node))
    params = options.additional_k8s_params
    for name, tree in (("ros_master", params.ros_master), ("application", params.application)):
        yield from find_in_patch(("additional_k8s_params", name), tree)
    for index, volume in enumerate(options.persistent_storage.volumes):
        if volume.host_path:
            message = OWNER.format(user=int(options.security.user), path=volume.host_path)
            place = ("persistent_storage", "volumes", index, "host_path")
            yield Problem(place, message, "volume-owner", severity="warning", at_key=True)


def check_node_security(node: NodeOptions) -> Iterator[Problem]:
    """Yield what a node requests that is not allowed; paths are the node's own."""
    if node.host_network:
        yield refuse(("host_network",), OWN_NETWORK, "remove `host_network`, or remove `security`")
    for path, what in find_in_context(node.security_context):
        yield refuse(("security_context", *path), what)
    for index, mount in enumerate(map(mount_of, node.volumes)):
        if mount.host_path:
            instead = "use one of persistent_storage.volumes, or remove `security`"
            yield refuse(("volumes", index), "directories and files of the machine", instead)
    for index, device in enumerate(map(device_of, node.devices)):
        if device.path:
            instead = "use a device plugin and `resource: squat.ai/NAME`, or remove `security`"
            yield refuse(("devices", index), "device files", instead)
    yield from find_in_patch(("patch",), node.patch)


def find_in_patch(path: Path, tree: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what a patch of a Deployment requests that is not allowed."""
    for below, what in find_violations(pod_of(tree)):
        yield refuse((*path, *POD, *below), what)


def refuse(path: Path, what: str, instead: str = "remove one of the two") -> Problem:
    """Return the problem of a value that the level does not allow."""
    message = f"security: restricted does not allow {what}: {instead}"
    return Problem(path, message, "restricted", at_key=True)
