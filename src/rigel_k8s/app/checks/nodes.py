"""What is wrong with one of `nodes`; paths are the node's own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

from rigel_k8s.app.checks.anonymous import check_anonymous
from rigel_k8s.app.checks.lines import check_line
from rigel_k8s.app.checks.parameters import IN_NODES, check_parameters, check_substitution
from rigel_k8s.app.checks.shells import check_shell_words
from rigel_k8s.app.components import check_components
from rigel_k8s.app.lifecycle import check_lifecycle
from rigel_k8s.app.mounts import device_of, mount_of, source_count
from rigel_k8s.app.nodes import port_of
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.generation import Generation
from rigel_k8s.objects.podoptions import EnvVar, Volume
from rigel_k8s.objects.raw import pod_of
from rigel_k8s.objects.scalars import RosName
from rigel_k8s.problems import Problem

#: Labels that identify objects.
RESERVED = ("app.kubernetes.io/", "rigel-k8s/")
#: Directories and files that each machine has of its own, so that no data are expected there.
EVERYWHERE = ("/dev", "/etc/localtime", "/proc", "/run", "/sys", "/tmp", "/var/run")
#: Options that a node reads at its start.
APPENDED = ("parameters", "remappings", "parameter_files", "parameter_commands")
#: Options that only ROS can read.
ROS_ONLY = ("name", "namespace", "package", "launch", "substitution_args", *APPENDED)


def check_node(key: str, options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong with the node of a key."""
    node = options.nodes[key]
    if node.image is None and options.image is None:
        message = f'"{key}" has no image: set one here, or one for all nodes as `image` of the job'
        yield Problem((), message, "missing-image", at_key=True)
    yield from check_readiness(node, ros)
    ros = ros.of_node(node)
    yield from check_name(key, node, ros)
    problems = list(check_command(node)) if ros.nodes else list(check_plain(node))
    yield from problems or check_appended(node, ros)
    yield from check_components(key, node, ros)
    yield from check_lifecycle(node, ros)
    yield from check_substitution(node, IN_NODES)
    yield from check_shell_words(node)
    yield from check_labels(node)
    yield from check_env(node)
    volumes = {str(volume.name): volume for volume in options.persistent_storage.volumes}
    yield from check_volumes(node, set(volumes))
    yield from check_anonymous(key, node, ros, volumes)
    yield from check_machine_data(node, volumes, restricted=options.security is not None)
    yield from check_devices(node, restricted=options.security is not None)
    yield from check_ports(node)
    yield from check_placement(key, node, options.nodes)


def check_name(key: str, node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield why a node cannot have its name, or have several pods."""
    if not ros.nodes:
        return
    if node.name is None and not node.anonymous and not node.launch:
        try:
            RosName.parse(key)
        except ValueError as error:
            yield Problem((), f"{error}, or set a `name`", RosName.kind, at_key=True)
    if node.name is not None and node.anonymous:
        message = "the name of an anonymous node is generated at its start: remove one of the two"
        yield Problem(("name",), message, "conflict", at_key=True)
    if node.replicas is not None and node.replicas > 1 and not node.anonymous:
        message = (
            f"ROS allows one node of a name, and {node.replicas} pods would {ros.clash};"
            " set anonymous: true if its name is generated at its start"
        )
        yield Problem(("replicas",), message, "duplicate-node")


def check_readiness(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield a readiness that a program without ROS never reaches."""
    if node.ros and node.readiness in ("ros", *(() if ros.dds else ("dds",))):
        message = f"a program without ROS (ros: none) never becomes ready by {node.readiness}"
        yield Problem(("readiness",), f"{message}: use a command or a file", "not-ros", at_key=True)


def check_plain(node: NodeOptions) -> Iterator[Problem]:
    """Yield options that a program without ROS cannot read."""
    what = "program without ROS" if node.ros else "plain DDS application"
    for key in ROS_ONLY:
        if getattr(node, key):
            message = f"a {what} (ros: none) has no {key}: use args and env"
            yield Problem((key,), message, "not-ros", at_key=True)
    for name in ("command", "args"):
        yield from check_line(node, (name,), getattr(node, name))


def check_labels(node: NodeOptions) -> Iterator[Problem]:
    """Yield labels that a user must not set."""
    for key in node.labels:
        if str(key).startswith(RESERVED):
            message = f'the label "{key}" identifies objects of a release: choose another name'
            yield Problem(("labels", str(key)), message, "reserved-label", at_key=True)


def check_command(node: NodeOptions) -> Iterator[Problem]:
    """Yield contradictions in what the container runs."""
    given = [name for name in ("command", "args", "launch") if getattr(node, name) is not None]
    pair = node.package is not None, node.executable is not None
    if any(pair) and not all(pair):
        there, missing = ("package", "executable") if pair[0] else ("executable", "package")
        yield Problem((there,), f"`{there}` without `{missing}`", "incomplete", at_key=True)
    if all(pair):
        given = [name for name in given if name != "args"] + ["package"]
    if len(given) > 1:
        listed = " and ".join(f"`{name}`" for name in given)
        message = f"{listed} each set what to run: keep one"
        if {"command", "args"} == set(given):
            message += " (args keeps the image's ENTRYPOINT, which sets up ROS)"
        yield Problem((given[1],), message, "conflict", at_key=True)
    for name in ("command", "args"):
        yield from check_line(node, (name,), getattr(node, name))


def check_appended(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield parameters and remappings that no program would read."""
    yield from check_parameters(node, ros)
    for key in (k for k in APPENDED if getattr(node, k)):
        if reason := explain_unreadable(node, key, ros):
            yield Problem((key,), reason, "not-appendable", at_key=True)


def explain_unreadable(node: NodeOptions, key: str, ros: Generation) -> str | None:
    """Return why a node could not read the key's value, None if it can."""
    if ros.program(node):
        return ros.explain_unreadable(node, key)
    return (
        f"{key} cannot be appended to the image's CMD:"
        " set what runs with args, package and executable, or launch"
    )


def check_env(node: NodeOptions) -> Iterator[Problem]:
    """Yield variables with two values."""
    if isinstance(node.env, Mapping):
        return
    names: set[str] = set()
    for index, item in enumerate(node.env):
        assert isinstance(item, EnvVar)
        if item.value is not None and item.value_from is not None:
            message = "value and valueFrom: remove one"
            yield Problem(("env", index, "value"), message, "conflict", at_key=True)
        if item.name in names:
            message = f'the variable "{item.name}" is already set'
            yield Problem(("env", index, "name"), message, "name-taken")
        names.add(item.name)


def check_volumes(node: NodeOptions, known: set[str]) -> Iterator[Problem]:
    """Yield mounts of nothing, of two things, of unknown volumes, and on the same path."""
    places: set[str] = set()
    for index, item in enumerate(node.volumes):
        mount = mount_of(item)
        path = ("volumes", index)
        if source_count(mount) != 1:
            message = "set exactly one of name, host_path, config_map, secret and memory"
            yield Problem(path, message, "bad-volume")
        elif mount.name and mount.name not in known:
            listed = ", ".join(sorted(known)) or "none"
            message = f'unknown volume "{mount.name}"; persistent_storage.volumes has: {listed}'
            yield Problem(path, message, "unknown-volume")
        elif mount.mount_path is None and not mount.name:
            yield Problem(path, "mount_path is missing", "bad-volume")
        place = str(mount.mount_path or mount.name)
        if place in places:
            yield Problem(path, f"another volume is already mounted at {place}", "name-taken")
        places.add(place)


def check_machine_data(
    node: NodeOptions, volumes: Mapping[str, Volume], *, restricted: bool
) -> Iterator[Problem]:
    """Yield directories of a machine that another machine does not have with the same content.

    Args:
        volumes: the release's persistent volumes, by name.
        restricted: a node's own `host_path` is already refused.
    """
    if node.placement.node_selector or is_placed(node.patch):
        return
    for index, mount in enumerate(map(mount_of, node.volumes)):
        own = None if restricted else mount.host_path
        volume = volumes.get(str(mount.name))
        path = PurePosixPath(str(own or (volume and volume.host_path) or "/dev"))
        if any(path.is_relative_to(place) for place in EVERYWHERE):
            continue
        message = (
            f"the pod sees {path} of the machine that it runs on, which may be another one after a"
            " restart: set placement.node (or placement.labels), or use persistent_storage without"
            " host_path"
        )
        yield Problem(("volumes", index), message, "any-machine", severity="warning")


def is_placed(patch: Mapping[str, Any]) -> bool:
    """Return whether a user's own part of a Deployment chooses its machine."""
    spec = pod_of(patch)
    return any(spec.get(key) for key in ("nodeName", "nodeSelector", "affinity"))


def check_devices(node: NodeOptions, *, restricted: bool) -> Iterator[Problem]:
    """Yield invalid devices, and those that the container may not open.

    Args:
        restricted: device files are already refused, so no remedy is given for them.
    """
    for index, device in enumerate(map(device_of, node.devices)):
        path = ("devices", index)
        if (device.path is None) == (device.resource is None):
            yield Problem(path, "set either path or resource", "bad-device")
        elif device.path and not restricted and not node.security_context.get("privileged"):
            message = (
                f"the container sees {device.path} but may not open it: add security_context:"
                " {privileged: true}, or use a device plugin and `resource: squat.ai/NAME`"
            )
            yield Problem(path, message, "device-access", severity="warning")


def check_ports(node: NodeOptions) -> Iterator[Problem]:
    """Yield ports and port names that occur twice."""
    seen: set[tuple[str, object]] = set()
    for index, port in enumerate(map(port_of, node.ports)):
        for what in (("port", (port.port, port.protocol)), ("name", port.name)):
            if what[1] is not None and what in seen:
                message = f"another port already has this {what[0]}"
                yield Problem(("ports", index), message, "name-taken")
            seen.add(what)


def check_placement(
    key: str, node: NodeOptions, nodes: Mapping[str, NodeOptions]
) -> Iterator[Problem]:
    """Yield contradicting placements, meaningless tolerations and raw parts that break."""
    for index, other in enumerate(node.placement.apart_from):
        if other not in nodes or other == key:
            message = f'"{other}" is not one of the other nodes'
            yield Problem(("placement", "apart_from", index), message, "unknown-node")
    for index, item in enumerate(node.tolerations):
        if item.value is not None and item.operator == "Exists":
            message = "Exists compares no value: remove `operator` or `value`"
            yield Problem(("tolerations", index, "value"), message, "conflict", at_key=True)
        if item.seconds is not None and item.effect != "NoExecute":
            message = "only NoExecute has `seconds`: add effect: NoExecute"
            yield Problem(("tolerations", index, "seconds"), message, "conflict", at_key=True)
