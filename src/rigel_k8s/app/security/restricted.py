"""Applies `security: restricted` to pods: the user, the privileges, the writable directories.

It fills in what is missing, so what a Rigelfile sets itself stays; the checks refuse what the level
does not allow. Images that run as root work too, because what ROS writes goes to volumes: HOME with
its logs, and /tmp.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rigel_k8s.app.security.options import Security
from rigel_k8s.generation import GENERATIONS, Generation
from rigel_k8s.objects.naming import ROS_ANNOTATION
from rigel_k8s.objects.overlay import simplify
from rigel_k8s.objects.pods import DEFAULT_CONTAINER, Object
from rigel_k8s.objects.podsecurity import pod_context

#: HOME of all containers: the image's own may belong to root.
HOME_PATH = "/rigel-k8s-home"
#: Where a container writes -> (the volume, how large it may become before the pod is evicted).
#: ROS 1 keeps up to 1.1 GB of each of a node's log files; roscore has three.
WRITABLE = {
    HOME_PATH: ("rigel-home", "4Gi"),
    "/tmp": ("rigel-tmp", "1Gi"),
}
#: A user without an entry in the image's /etc/passwd still has a name for programs that need one.
USER_NAME = "ros"
CONTAINERS = ("initContainers", "containers")
ROS_HOME = f"{HOME_PATH}/.ros"
LOG_PATH = f"{ROS_HOME}/log"
#: ROS 1 gives each directory that it creates the owner of its parent, and writes no log at all if
#: it may not. A volume belongs to root, so a container of the same user creates the first ones.
INIT_NAME = "rigel-home"
#: What that container copies from the one that it prepares HOME for.
SHARED = ("image", "imagePullPolicy", "resources")
IDENTITY = ("runAsUser", "runAsGroup", "seLinuxOptions")


def restrict(item: Mapping[str, Any], security: Security, ros: Generation) -> Object:
    """Return a Deployment whose pods pass the level "restricted"; other objects unchanged."""
    if item["kind"] != "Deployment":
        return dict(item)
    made: Object = simplify(item)
    template = made["spec"]["template"]
    pod = template["spec"]
    ros = GENERATIONS[template["metadata"].get("annotations", {}).get(ROS_ANNOTATION, ros.name)]
    pod["securityContext"] = pod_context(int(security.user)) | (pod.get("securityContext") or {})
    if ros.prepares_home and pod.get("containers"):
        prepare_home(template)
    for kind in CONTAINERS:
        for container in pod.get(kind) or ():
            restrict_container(container, ros, read_only=security.read_only)
    named = {volume["name"] for volume in pod.get("volumes") or ()}
    used = {mount["name"] for kind in CONTAINERS for mount in list_mounts(pod.get(kind) or ())}
    pod["volumes"] = [
        *(pod.get("volumes") or ()),
        *(
            {"name": name, "emptyDir": {"sizeLimit": limit}}
            for name, limit in WRITABLE.values()
            if name in used - named
        ),
    ]
    return made


def prepare_home(template: Object) -> None:
    """Add the container that creates ROS 1's directories before the others start."""
    pod, meta = template["spec"], template["metadata"]
    first = pod["containers"][0]
    pod["initContainers"] = [home_container(first), *pod.get("initContainers", ())]
    meta["annotations"] = {DEFAULT_CONTAINER: first["name"], **meta.get("annotations", {})}


def home_container(container: Mapping[str, Any]) -> Object:
    """Return the init container that creates ROS 1's directories, as the user of a container."""
    own = container.get("securityContext") or {}
    return {
        "name": INIT_NAME,
        **{key: container[key] for key in SHARED if key in container},
        "command": ["/bin/sh", "-c", f"mkdir -p {LOG_PATH}"],
        "securityContext": {key: own[key] for key in IDENTITY if key in own},
    }


def restrict_container(container: Object, ros: Generation, *, read_only: bool) -> None:
    """Fill in a container's securityContext, variables and mounts."""
    own = container.get("securityContext") or {}
    default: Object = {"allowPrivilegeEscalation": False}
    if read_only:
        default["readOnlyRootFilesystem"] = True
    capabilities = {**(own.get("capabilities") or {}), "drop": ["ALL"]}
    container["securityContext"] = {**default, **own, "capabilities": capabilities}
    mounts = container.get("volumeMounts") or []
    taken = {str(mount["mountPath"]).rstrip("/") for mount in mounts}
    ours = [
        {"name": name, "mountPath": path}
        for path, (name, _) in WRITABLE.items()
        if path not in taken
    ]
    container["volumeMounts"] = [*mounts, *ours]
    env = container.get("env") or []
    known = {variable["name"] for variable in env}
    container["env"] = [
        *env,
        *({"name": n, "value": v} for n, v in variables(ros).items() if n not in known),
    ]


def variables(ros: Generation) -> dict[str, str]:
    """Return the variables that point programs to where they may write."""
    home = {"HOME": HOME_PATH, "USER": USER_NAME, "LOGNAME": USER_NAME}
    if not ros.nodes:
        return home
    # An image may set these to directories of root.
    return home | {"ROS_HOME": ROS_HOME, "ROS_LOG_DIR": LOG_PATH}


def list_mounts(containers: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """Yield the mounts of containers."""
    for container in containers:
        yield from container.get("volumeMounts") or ()
