"""The keys of a service as options of a node."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

from rigel_import.compose.mounts import add_devices, add_ports, add_volumes
from rigel_import.compose.service import OF_ROS1, Service, locate_build
from rigel_import.compose.values import Value
from rigel_import.draft import use_var
from rigel_k8s.ros import ROS_ARGS

#: Keys that are read, and those that need no counterpart.
READ = frozenset(
    ("build", "build.args", "build.context", "build.dockerfile", "cap_add", "cap_drop", "command")
    + ("container_name", "cpus", "deploy", "deploy.replicas", "deploy.resources")
    + ("deploy.resources.limits.cpus", "deploy.resources.limits.memory")
    + ("deploy.resources.reservations.cpus", "deploy.resources.reservations.memory")
    + ("deploy.resources.reservations.devices", "devices", "entrypoint", "env_file")
    + ("environment", "expose", "gpus", "image", "init", "ipc", "logging", "mem_limit")
    + ("mem_reservation", "networks", "ports", "privileged", "read_only", "shm_size", "stdin_open")
    + ("tty", "user", "volumes", "working_dir")
)
RESERVED = "deploy.resources.reservations"
#: Values of other keys that need no counterpart.
AS_IS = re.compile(
    "network_mode (host|bridge|default)|restart (always|unless-stopped)|runtime (nvidia|runc)"
)
#: The other keys that robots have most often, and what takes their place.
ADVICE: Mapping[str, str] = {
    "": "set what Kubernetes has in its place in `patch`, if the program needs it",
    "build": "set it in the Dockerfile, or as an option of the job that builds the image",
    "build.target": "let the Dockerfile end with this stage",
    "configs": "add the file to `files`",
    "deploy.restart_policy": "Kubernetes starts a program again that has ended",
    "depends_on": "all nodes start at once and find each other when they are there; a program that"
    " gives up is started again",
    "extra_hosts": "set hostAliases of the pod in `patch`",
    "group_add": "set securityContext.supplementalGroups of the pod in `patch`, with numbers",
    "healthcheck": "set `readiness` with its command; a pod that is not ready is not restarted",
    "hostname": "the pod's name is its hostname; nodes reach it by its Service, see `ports`",
    "labels": "set `labels` of the node",
    "network_mode": "each pod has an address of its own; nodes that need localhost to reach each"
    " other need host_network",
    "networks": "a pod has one address, which changes; others find it by its Service, see `ports`",
    "pid": "set hostPID: true in `patch`, if the program needs the machine's processes",
    "profiles": "the node is always started; delete it if it is not needed",
    "restart": "Kubernetes starts a program again that has ended; one that runs once is a"
    " `kind: task`",
    "runtime": "set `runtime_class` to what the cluster calls it",
    "secrets": "create a Secret, and add {secret: NAME, mount_path: PATH} to `volumes`",
    "security_opt": "set seccompProfile or appArmorProfile in `security_context`",
    "stop_grace_period": "set `termination_grace_period`",
    "sysctls": "set securityContext.sysctls of the pod in `patch`; a machine may refuse them",
    "tmpfs": "add {memory: SIZE, mount_path: PATH} to `volumes`",
    "ulimits": "set them in the machine's container runtime, or in the image's entrypoint",
}
#: Variables that are left out of `env`, and why.
LEFT_OUT = {
    **dict.fromkeys(
        ("ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")
        + ("ROS_DISCOVERY_SERVER", "ROS_SUPER_CLIENT", "CYCLONEDDS_URI", "ZENOH_CONFIG_OVERRIDE")
        + ("ZENOH_SESSION_CONFIG_URI", "ZENOH_ROUTER_CHECK_ATTEMPTS")
        + ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"),
        "`network` decides how nodes find each other; add it to `env` if the profile has more",
    ),
    **dict.fromkeys(("DISPLAY", "XAUTHORITY", "QT_X11_NO_MITSHM"), "a pod has no X display"),
    "NVIDIA_VISIBLE_DEVICES": "the device plugin sets it to the GPUs of the pod",
}

#: Options of roslaunch and ros2 launch that change nothing in a pod.
QUIET = ("--wait", "--screen", "--noninteractive", "-n")
#: Rules of arguments that are options of a node.
NAMES = {"__node": "name", "__name": "name", "__ns": "namespace"}
UNNAMED = (
    "the ROS name is not in the Compose file: if it is always the same, set `name` to it and remove"
    " `anonymous` and `update`, so that updates hand over"
)


def translate(service: Service, network: Mapping[str, Any]) -> None:
    """Add the options of a service's keys to its node, which is in a job with this network."""
    service.options["image"] = service.content.get("image").written
    add_program(service)
    add_environment(service)
    add_network(service, network)
    add_devices(service)
    add_volumes(service)
    add_security(service)
    add_resources(service)
    add_replicas(service, network)
    if directory := service.content.get("working_dir").written:
        container = {"name": "ros-node", "workingDir": directory}
        service.options["patch"] = {"spec": {"template": {"spec": {"containers": [container]}}}}
    remark_others(service)


def add_program(service: Service) -> None:
    """Add the options of what a service runs."""
    if service.ros is None:
        service.options["ros"] = "none"
    service.options |= read_program(service)
    if service.ros and not {"name", "launch", "kind"} & service.options.keys():
        service.options |= {"anonymous": True, "update": {"strategy": "Recreate"}}
        service.remark(service.content, UNNAMED)


def read_program(service: Service) -> dict[str, Any]:
    """Return the options of what a service runs."""
    words = [word.written for word in service.content.get("command").words()]
    entrypoint = service.content.get("entrypoint")
    if entrypoint.content is not None:  # an empty one replaces the image's, too
        words = [*(word.written for word in entrypoint.words() if word.written), *words]
        return {"command": words} if words else {}
    match words:
        case ["ros2", "launch", *rest] | ["roslaunch", *rest]:
            if launch := read_launch(rest):
                return {"launch": launch}
        case ["ros2", "run", package, executable, *rest] | ["rosrun", package, executable, *rest]:
            if not package.startswith("-"):
                return {"package": package, "executable": executable, **read_arguments(rest)}
    return {"args": words} if words else {}


def read_launch(words: Sequence[str]) -> dict[str, Any] | None:
    """Return the option `launch` for a package, a file and arguments; None if there is more."""
    names = [word for word in words if ":=" not in word and word not in QUIET]
    args = dict(word.partition(":=")[::2] for word in words if ":=" in word)
    if len(names) not in (1, 2) or any(name.startswith("-") for name in names):
        return None
    launch: dict[str, Any] = {"package": names[0]} if len(names) == 2 else {}
    launch["file"] = names[-1]
    return {**launch, "args": args} if args else launch


def read_arguments(words: Sequence[str]) -> dict[str, Any]:
    """Return a node's name, namespace, and its other arguments."""
    options: dict[str, Any] = {}
    args: list[str] = []
    for word in words:
        name, _, value = word.partition(":=")
        if name in NAMES:
            options[NAMES[name]] = value
            args = args[:-1] if args[-1:] in (["-r"], ["--remap"]) else args
        else:
            args.append(word)
    args = args[:-1] if args[-1:] == [ROS_ARGS] else args
    return {"args": args, **options} if args else options


def add_environment(service: Service) -> None:
    """Add the variables of a service; `rigel` sets some of them."""
    env = {}
    for name, value in service.environment.items():
        how = LEFT_OUT.get(name, "" if name.isidentifier() else "`env` refuses such a name")
        if name in OF_ROS1 and service.ros == "1":
            how = "nodes use the release's ros-master; for another one, set `ros_master_uri`"
        if how:
            service.remark(value, f"{name} is left out: {how}")
        elif value.content is None:
            message = f"{name} is that of the machine that runs docker compose: set it in `env`"
            service.remark(value, message)
        else:
            env[name] = value.written
    if env:
        service.options["env"] = env


def add_network(service: Service, network: Mapping[str, Any]) -> None:
    """Add how a service shares the network and the memory of its machine."""
    ipc = service.content.get("ipc")
    if not service.is_on_host:
        add_ports(service)
    elif network.get("mode") != "host":
        service.options["host_network"] = True
    if ipc.text == "host" and service.ros == "2" and not network.get("shared_memory"):
        message = "nodes that exchange large messages share memory in one `pod`"
        service.remark(ipc, f"ipc: host is not carried over: {message}")
    size = service.content.get("shm_size")
    if size.text and ipc.text != "host":
        service.append("volumes", {"memory": size.size(), "mount_path": "/dev/shm"})


def add_security(service: Service) -> None:
    """Add what a container may do, and its user; it may open a device only if it is privileged."""
    content = service.content
    context: dict[str, Any] = {}
    if content.get("privileged").text == "true" or content.get("devices").elements():
        context["privileged"] = True
    if content.get("read_only").text == "true":
        context["readOnlyRootFilesystem"] = True
    for kind in ("add", "drop"):
        if capabilities := content.get(f"cap_{kind}").elements():
            names = [item.text.upper().removeprefix("CAP_") for item in capabilities]
            context.setdefault("capabilities", {})[kind] = names
    user, _, group = re.sub(r"\broot\b", "0", content.get("user").text).partition(":")
    if (user + group).isdigit():
        context["runAsUser"] = int(user)
        context |= {"runAsGroup": int(group)} if group else {}
    elif user:
        how = f'set runAsUser in `security_context` to the number of the user "{user}"'
        service.remark(content.get("user"), how)
    if context:
        service.options["security_context"] = context


def add_resources(service: Service) -> None:
    """Add how much of a machine a service requests, and may use."""
    content = service.content
    limits = content.get("deploy", "resources", "limits")
    requests = content.get("deploy", "resources", "reservations")
    resources: dict[str, dict[str, Any]] = {"limits": {}, "requests": {}}
    for kind, cpus, memory in (
        ("limits", content.get("cpus"), content.get("mem_limit")),
        ("limits", limits.get("cpus"), limits.get("memory")),
        ("requests", Value(content.place), content.get("mem_reservation")),
        ("requests", requests.get("cpus"), requests.get("memory")),
    ):
        resources[kind] |= {"cpu": cpus.text} if cpus.text else {}
        resources[kind] |= {"memory": memory.size()} if memory.text else {}
    gpus = [*content.get("gpus").elements(), *requests.get("devices").elements()]
    if gpus or content.get("runtime").text == "nvidia":
        resources["limits"]["nvidia.com/gpu"] = count_gpus(service, gpus[0]) if gpus else 1
        service.options["runtime_class"] = "nvidia"
        if "kind" not in service.options:  # two pods need twice as many GPUs
            service.options["update"] = {"strategy": "Recreate"}
    if any(resources.values()):
        service.options["resources"] = {kind: some for kind, some in resources.items() if some}


def add_replicas(service: Service, network: Mapping[str, Any]) -> None:
    """Add how many pods a node has, or remark why it has one."""
    count, options = service.content.get("deploy", "replicas"), service.options
    named = not {"anonymous", "ros"} & options.keys()
    if count.text in ("", "1"):
        return
    if count.text != "0" and (named or network.get("mode") == "peers"):
        how = "ROS allows one node of a name; set `replicas` with `anonymous: true` if its name is"
        how = f"{how} generated" if named else "with peers, write a node for each of them"
        service.remark(count, f"`deploy.replicas` is not carried over: {how}")
    elif count.text.isdigit():
        options["replicas"] = int(count.text)


def count_gpus(service: Service, request: Value) -> int:
    """Return how many GPUs a service requests, one if it does not set a number."""
    count = (request.get("count") if request.entries() else request).text
    if count.isdigit():
        return int(count)
    service.remark(request, "one GPU is requested: change `nvidia.com/gpu` if it needs more")
    return 1


def remark_others(service: Service) -> None:
    """Remark the keys that are not carried over."""
    entries = dict(service.content.entries())
    for key in ("build", "deploy", "networks", "deploy.resources.limits", RESERVED):
        below = service.content.get(*key.split(".")).entries()
        entries |= {f"{key}.{name}": value for name, value in below.items()}
    for key, value in entries.items():
        is_set = value.content not in (None, "", [], {}) and not key.startswith("x-")
        if is_set and key not in READ and not AS_IS.fullmatch(f"{key} {value.written}"):
            advice = ADVICE.get(key) or ADVICE.get(key.partition(".")[0]) or ADVICE[""]
            service.remark(value, f"`{key}` is not carried over: {advice}")


def add_build(service: Service, jobs: dict[str, dict[str, Any]]) -> None:
    """Add the job that builds a service's image, if it builds one that no other job builds."""
    build = service.content.get("build")
    if build.content is None:
        return
    image = service.content.get("image").written or service.name
    if "/" not in (service.content.get("image").text or service.name):
        image = f"{use_var('registry')}/{image}"
        service.remark(build, "set `registry` under `vars` to a registry that you may push to")
    service.options["image"] = image
    context, dockerfile = locate_build(build)
    if re.match(r"[\w+]+:|git@", context):
        service.remark(build, "its context is not a directory: clone it, and set `context` to that")
    context = os.path.relpath(context, service.directory)
    options: dict[str, Any] = {"image": image, "context": context, "dockerfile": dockerfile}
    if args := build.get("args").pairs():
        options["buildargs"] = {name: value.written for name, value in args.items()}
    if all(job["with"]["image"] != image for job in jobs.values()):
        content = {"plugin": "rigel_k8s.BuildXPlugin", "with": {**options, "push": True}}
        jobs[f"build_{service.key}"] = content
