"""What is wrong with one of `nodes`; paths are the node's own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath

from rigel_k8s.app.checks.commands import (
    IN_NODES,
    check_line,
    check_parameter_options,
    check_program,
    check_shell_words,
    check_substitution,
)
from rigel_k8s.app.checks.kubernetes import check_kubernetes
from rigel_k8s.app.components import check_components, check_key, check_ros_names
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.layer import choose_layer, explain_left_out
from rigel_k8s.app.lifecycle import check_lifecycle
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.programs import SHELLS, full_name
from rigel_k8s.app.testing import check_kind
from rigel_k8s.app.updating import find_clash, find_exclusive, is_rolling, patches_privileged
from rigel_k8s.app.volumes import device_of, mount_of, source_count
from rigel_k8s.network.options import Network
from rigel_k8s.objects.naming import HOSTNAME
from rigel_k8s.objects.overlay import containers_of, find_below, mapping, pod_of
from rigel_k8s.objects.podoptions import Readiness, Volume
from rigel_k8s.objects.resources import check_resources, explain_few_bytes
from rigel_k8s.objects.scalars import LabelKey
from rigel_k8s.problems import Path, Problem, Severity

#: Labels that identify objects.
RESERVED = ("app.kubernetes.io/", "rigel-k8s/")
#: Directories and files that each machine has of its own, so that no data are expected there.
EVERYWHERE = (
    "/dev",
    "/etc/localtime",
    "/etc/machine-id",
    "/proc",
    "/run",
    "/sys",
    "/tmp",
    "/var/run",
)
#: What is reported of a machine's directory: of one that other machines have as well, and of one
#: that may belong to another user.
ANY_MACHINE = (
    "the pod sees {path} of the machine that it runs on, which may be another one after a restart:"
    " set placement.node (or placement.labels), or use persistent_storage without host_path"
)
OWNER = (
    "a new {path} on the machine belongs to root: if the image runs as another user, run"
    " `chown UID {path}` there, and set security_context: {{runAsUser: UID}}; if the node only"
    " reads, set read_only: true"
)
#: Devices that each machine has.
USUAL_DEVICES = ("/dev/fuse", "/dev/net/tun", "/dev/null", "/dev/shm")
#: Options that a node reads at its start.
APPENDED = ("parameters", "remappings", "parameter_files", "parameter_commands")
#: Fields of a Deployment that are options of a node.
PATCHED = {
    ("spec", "replicas"): "replicas",
    ("spec", "strategy"): "update",
    ("spec", "template", "spec", "hostNetwork"): "host_network",
}
#: Subcommands of `ros2` that start a user's own nodes.
STARTERS = ("run", "launch")
#: Options that only ROS can read.
ROS_ONLY = ("name", "namespace", "package", "launch", "substitution_args", *APPENDED)


def check_node(key: str, options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    node = options.nodes[key]
    if node.image is None and options.image is None:
        message = f'"{key}" has no image: set one here, or one for all nodes as `image` of the job'
        yield Problem((), message, "missing-image", at_key=True, because=(("image",),))
    yield from check_kind(node)
    yield from check_readiness_without_ros(node, ros)
    ros = ros.of_node(node)
    yield from check_node_name(key, node, ros)
    problems = list(check_command(node)) if ros.nodes else list(check_plain(node))
    yield from problems
    if not any(problem.is_error for problem in problems):
        yield from check_appended(node, ros)
    yield from check_program(node, ros)
    yield from check_components(key, node, ros)
    yield from check_lifecycle(node, ros)
    yield from check_measured(choose_layer(node, options), ros)
    yield from check_substitution(node, IN_NODES)
    yield from check_shell_words(node)
    yield from check_labels(node)
    yield from check_resources(node.resources)
    volumes = {str(volume.name): volume for volume in options.persistent_storage.volumes}
    yield from check_node_volumes(node, set(volumes))
    yield from check_kubernetes(node, options, ros)
    yield from check_patched(node, ros)
    if node.kind is None:
        yield from check_anonymous(key, node, ros, volumes, options.network)
    yield from check_machine_data(node, volumes, restricted=options.security is not None)
    yield from check_devices(node, restricted=options.security is not None)
    yield from check_placement(key, node, options.nodes)


def check_node_name(key: str, node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield why a node cannot have its name, or have several pods."""
    if not ros.nodes:
        return
    if node.name is None and not node.anonymous and not node.launch:
        yield from check_key(key, ros)
    yield from check_ros_names(node, ros)
    if node.name is not None and node.anonymous:
        message = "the name of an anonymous node is generated at its start: remove one of the two"
        yield Problem(("name",), message, "conflict", at_key=True)
    if node.replicas is not None and node.replicas > 1 and not node.anonymous:
        message = (
            f"ROS allows one node of a name, and {node.replicas} pods would {ros.clash};"
            " set anonymous: true if its name is generated at its start"
        )
        yield Problem(("replicas",), message, "duplicate-node")


def check_readiness_without_ros(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield a readiness that a program without ROS never reaches."""
    if node.ros and node.readiness in ("ros", *(() if ros.dds else ("dds",))):
        message = f"a program without ROS (ros: none) never becomes ready by {node.readiness}"
        yield Problem(("readiness",), f"{message}: use a command or a file", "not-ros", at_key=True)


def check_measured(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield why no one knows whether a node's executors turn, or how often it publishes."""
    if node.liveness and node.liveness.stuck is None and not node.liveness.silent:
        message = "it has no effect: set `stuck` or `silent`"
        yield Problem(("liveness",), message, "incomplete", at_key=True)
    rates = isinstance(node.readiness, Readiness) and node.readiness.rates
    for path, is_set in {("liveness",): node.liveness, ("readiness", "rates"): rates}.items():
        if not is_set:
            continue
        key = path[-1]
        if not ros.rmw:
            message = f"only nodes of ROS 2 have `{key}`: remove it"
        elif why := explain_left_out(node, ros.find_program(node)):
            message = f"`{key}` needs the library in the node's processes, but {why}"
        else:
            continue
        yield Problem(path, message, key, at_key=True)


def check_plain(node: NodeOptions) -> Iterator[Problem]:
    """Yield options that a program without ROS cannot read."""
    what = "program without ROS" if node.ros else "plain DDS application"
    for key in ROS_ONLY:
        if getattr(node, key):
            message = f"a {what} (ros: none) has no {key}: use args and env"
            yield Problem((key,), message, "not-ros", at_key=True)
    yield from check_lines(node)


def check_lines(node: NodeOptions) -> Iterator[Problem]:
    """Yield what is wrong with the lines of a container."""
    for name in ("command", "args"):
        if getattr(node, name) is not None:
            yield from check_line((name,), getattr(node, name), node)


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
    yield from check_lines(node)


def check_appended(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield parameters and remappings that no program would read."""
    yield from check_parameter_options(node, ros)
    runs = bool(ros.program(node))
    for key in (k for k in APPENDED if getattr(node, k)):
        reason: str | None = (
            f"{key} cannot be appended to the image's CMD:"
            " set what runs with args, package and executable, or launch"
        )
        if runs:
            reason = ros.explain_unreadable(node, key)
        if reason:
            yield Problem((key,), reason, "not-appendable", at_key=True)


def check_node_volumes(node: NodeOptions, known: set[str]) -> Iterator[Problem]:
    """Yield mounts of nothing, of two things, and of unknown volumes."""
    for index, mount in enumerate(map(mount_of, node.volumes)):
        path = ("volumes", index)
        if source_count(mount) != 1:
            message = "set exactly one of name, host_path, config_map, secret and memory"
            yield Problem(path, message, "bad-volume")
        elif mount.name and mount.name not in known:
            listed = ", ".join(sorted(known)) or "none"
            message = f'unknown volume "{mount.name}"; persistent_storage.volumes has: {listed}'
            because: tuple[Path, ...] = (("persistent_storage", "volumes"),)
            yield Problem(path, message, "unknown-volume", because=because)
        elif mount.mount_path is None and not mount.name:
            yield Problem(path, "mount_path is missing", "bad-volume")
        elif mount.type and not mount.host_path:
            yield Problem((*path, "type"), "type is that of a host_path: remove it", "bad-volume")
        elif problem := explain_few_bytes(mount.memory):
            yield Problem((*path, "memory"), problem, "bad-quantity")


def check_patched(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what a patch has of the node's own options, which are checked, and complete."""
    for path, option in PATCHED.items():
        value = find_below(node.patch, path)
        if value in (None, False) or isinstance(value, str) or node.kind:
            continue
        clash = option == "replicas" and value not in (0, 1) and ros.nodes and not node.anonymous
        severity: Severity = "error" if clash else "warning"
        message = f"`rigel` reads the node's own option, `{option}`: write it there"
        yield Problem(("patch", *path), message, "patched", severity=severity, at_key=True)


def check_anonymous(
    key: str,
    node: NodeOptions,
    ros: Generation,
    volumes: Mapping[str, Volume],
    network: Network | None,
) -> Iterator[Problem]:
    """Yield a warning of two pods at once, or of a name that no node has.

    Args:
        key: the node's key in `nodes`.
        ros: the node's own.
        volumes: the release's persistent volumes, by name.
    """
    line = ros.find_program(node) if ros.nodes else []
    if node.anonymous:
        if not find_exclusive(node, volumes, network):
            yield from check_two_at_once(node, find_clash(node, volumes) or find_group(line))
    elif line[:1] == ["ros2"] and line[1:] and line[1] not in STARTERS:
        message = (
            f"no ROS node is called {full_name(key, node)}, since ros2 {line[1]} names its node"
            " itself: set anonymous: true, with update: {strategy: Recreate} if two pods must not"
            " run at once"
        )
        path = "command" if node.command is not None else "args"
        yield Problem((path,), message, "own-name", severity="warning", at_key=True)


def check_two_at_once(node: NodeOptions, reason: str | None) -> Iterator[Problem]:
    """Yield that an anonymous node's default update runs two pods that disturb each other.

    Args:
        reason: why two of them do; None if they do not.
    """
    update = node.update
    if reason is None or is_rolling(update) or (update is not None and update.strategy):
        return
    if node.replicas is not None and node.replicas > 1:
        return
    message = (
        f"the node is anonymous, so an update runs its old and its new pod at once, but {reason}:"
        " set update: {strategy: Recreate}, or {strategy: Rolling} if two pods may run at once"
    )
    yield Problem(("anonymous",), message, "two-at-once", severity="warning", at_key=True)


def find_group(line: Sequence[str]) -> str | None:
    """Return what a command line starts that is more than one node."""
    name = PurePosixPath(line[0]).name if line else ""
    if name == "roslaunch" or (name == "ros2" and line[1:2] == ["launch"]):
        return "each pod starts all nodes of the launch file"
    return f"each pod starts all that {name} starts" if name in SHELLS else None


def check_machine_data(
    node: NodeOptions, volumes: Mapping[str, Volume], *, restricted: bool
) -> Iterator[Problem]:
    """Yield directories of a machine that another one does not have with the same content.

    Where there is no other one: those that the container's user may not be able to write to.

    Args:
        volumes: the release's persistent volumes, by name.
        restricted: a node's own `host_path` is already refused, and its user is known.
    """
    pod = pod_of(node.patch)
    patched = any(pod.get(key) for key in ("nodeName", "nodeSelector", "affinity"))
    pinned = bool(node.placement.node_selector) or patched
    contexts = [mapping(one.get("securityContext")) for one in (pod, *containers_of(node.patch))]
    has_user = any("runAsUser" in context for context in (node.security_context, *contexts))
    for index, mount in enumerate(map(mount_of, node.volumes)):
        own = None if restricted else mount.host_path
        volume = volumes.get(str(mount.name))
        path = PurePosixPath(str(own or (volume and volume.host_path) or "/dev"))
        if any(path.is_relative_to(place) for place in EVERYWHERE):
            continue
        if pinned and (restricted or has_user or mount.read_only):
            continue
        kind, text = ("volume-owner", OWNER) if pinned else ("any-machine", ANY_MACHINE)
        message = text.format(path=path)
        yield Problem(("volumes", index), message, kind, severity="warning")
    if restricted or pinned:
        return
    for index, device in enumerate(map(device_of, node.devices)):
        if device.path and not device.resource and str(device.path) not in USUAL_DEVICES:
            message = (
                f"the pod waits for ever on a machine without {device.path}: set placement.node (or"
                " placement.labels)"
            )
            yield Problem(("devices", index), message, "any-machine", severity="warning")
            return  # the others are probably on the same machine


def check_devices(node: NodeOptions, *, restricted: bool) -> Iterator[Problem]:
    """Yield invalid devices, and those that the container may not open.

    Args:
        restricted: device files are already refused, so no remedy is given for them.
    """
    is_privileged = node.security_context.get("privileged") or patches_privileged(node.patch)
    for index, device in enumerate(map(device_of, node.devices)):
        path = ("devices", index)
        if (device.path is None) == (device.resource is None):
            yield Problem(path, "set either path or resource", "bad-device")
        elif device.path and ":" in device.path and not device.mount_path:
            message = (
                f"a path in a container has no colon, so there it is {device.path.inside}: set"
                " `mount_path` for another one"
            )
            yield Problem(path, message, "device-path", severity="warning")
        is_file = device.path and not device.resource
        if is_file and not restricted and not is_privileged:
            message = (
                f"the container sees {device.path} but may not open it: add security_context:"
                " {privileged: true}, or use a device plugin and `resource: squat.ai/NAME`"
            )
            yield Problem(path, message, "device-access", severity="warning")


def check_placement(
    key: str, node: NodeOptions, nodes: Mapping[str, NodeOptions]
) -> Iterator[Problem]:
    """Yield that a node keeps away from one that does not exist, or from itself."""
    for index, other in enumerate(node.placement.apart_from):
        if other not in nodes or other == key:
            message = f'"{other}" is not one of the other nodes'
            yield Problem(("placement", "apart_from", index), message, "unknown-node")
    named, labelled = node.placement.node, node.placement.labels.get(LabelKey(HOSTNAME))
    if named and labelled and str(named) != str(labelled):
        message = f"`node` is another machine, {named}: remove one of the two"
        yield Problem(("placement", "labels", HOSTNAME), message, "conflict", at_key=True)
