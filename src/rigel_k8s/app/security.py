"""`security: restricted`: the user of pods, their privileges, their writable directories.

It fills in what is missing, so what a Rigelfile sets itself stays; app/checks/security.py refuses
what the level does not allow. Images that run as root work too, because what ROS writes goes to
volumes: HOME with its logs, and /tmp.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.naming import ROS_ANNOTATION
from rigel_k8s.objects.overlay import simplify
from rigel_k8s.objects.pods import DEFAULT_CONTAINER, Object
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.objects.scalars import Number
from rigel_k8s.ros import BY_NAME, Ros

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
ROS_HOME = f"{HOME_PATH}/.ros"
LOG_PATH = f"{ROS_HOME}/log"
#: ROS 1 gives each directory that it creates the owner of its parent, and writes no log at all if
#: it may not. A volume belongs to root, so a container of the same user creates the first ones.
INIT_NAME = "rigel-home"
#: What that container copies from the one that it prepares HOME for.
SHARED = ("image", "imagePullPolicy", "resources")
IDENTITY = ("runAsUser", "runAsGroup", "seLinuxOptions")

#: The level's name in a Rigelfile, as in Kubernetes.
Level = Literal["restricted"]


class UserId(Number):
    """A numeric user that is not root."""

    kind = "bad-user"
    expects = "a numeric user ID, 1 or more (0 is root)"
    least = 1


@attrs.frozen(kw_only=True)
class Security:
    """What the application's containers may do."""

    level: Level = option(
        "restricted: pods pass Kubernetes' Pod Security level of that name: no root, no privileges,"
        " a read-only image, HOME and /tmp as volumes of the pod",
        "restricted",
    )
    user: UserId = option(
        "the numeric user and group of the containers; the image does not need an entry for it",
        UserId(1000),
    )
    read_only: bool = option("mount the images read-only; HOME and /tmp are writable", default=True)


def security_of(value: Security | Level | None) -> Security | None:
    """Return the security; a word is short for its `level`."""
    return Security(level=value) if isinstance(value, str) else value


def restrict(item: Mapping[str, Any], security: Security, ros: Ros) -> Object:
    """Return a workload whose pods pass the level "restricted"; other objects unchanged."""
    if item["kind"] not in ("Deployment", "Job"):
        return dict(item)
    made: Object = simplify(item)
    template = made["spec"]["template"]
    pod = template["spec"]
    ros = BY_NAME[template["metadata"].get("annotations", {}).get(ROS_ANNOTATION, ros.name)]
    pod["securityContext"] = pod_context(int(security.user)) | (pod.get("securityContext") or {})
    if ros.prepares_home and pod.get("containers"):
        prepare_home(template)
    containers = [*(pod.get("initContainers") or ()), *(pod.get("containers") or ())]
    for container in containers:
        restrict_container(container, ros, read_only=security.read_only)
    volumes = pod.get("volumes") or ()
    named = {volume["name"] for volume in volumes}
    used = {mount["name"] for one in containers for mount in one.get("volumeMounts") or ()}
    pod["volumes"] = [
        *volumes,
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
    own = first.get("securityContext") or {}
    init = {
        "name": INIT_NAME,
        **{key: first[key] for key in SHARED if key in first},
        "command": ["/bin/sh", "-c", f"mkdir -p {LOG_PATH}"],
        "securityContext": {key: own[key] for key in IDENTITY if key in own},
    }
    pod["initContainers"] = [init, *pod.get("initContainers", ())]
    meta["annotations"] = {DEFAULT_CONTAINER: first["name"], **meta.get("annotations", {})}


def restrict_container(container: Object, ros: Ros, *, read_only: bool) -> None:
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


def variables(ros: Ros) -> dict[str, str]:
    """Return the variables that point programs to where they may write."""
    home = {"HOME": HOME_PATH, "USER": USER_NAME, "LOGNAME": USER_NAME}
    if not ros.nodes:
        return home
    # An image may set these to directories of root.
    return home | {"ROS_HOME": ROS_HOME, "ROS_LOG_DIR": LOG_PATH}
