"""Files that a mode brings into pods: a ConfigMap of the release, and what an init container makes.

An init container is needed where a file holds the pod's own address, and where a pod must not start
without its interface. It runs the pod's own image, of which it wants no more than a shell.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from rigel_k8s.network.dds import FILES_PATH
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.workloads import ReleaseContext, config_map

Object = dict[str, Any]

SCRIPT = "interface.sh"
#: Where the init container finds what the ConfigMap has.
SOURCE_PATH = "/rigel-k8s-network-source"
SOURCE_VOLUME, VOLUME = "rigel-network-source", "rigel-network"
INIT_NAME = "rigel-network"

#: Whom a container runs as, which a namespace may ask of init containers too.
IDENTITY = ("runAsUser", "runAsGroup", "runAsNonRoot", "seccompProfile", "seLinuxOptions")
#: It reads /proc and writes to an emptyDir.
HARMLESS = {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}

#: Fast DDS 3 takes programs that read one machine-id for neighbours, and images bring one id into
#: all their pods; with an interface allowed and no other it then sends a neighbour nothing at all.
MACHINE_ID = {
    "name": VOLUME,
    "mountPath": "/etc/machine-id",
    "subPath": "machine-id",
    "readOnly": True,
}


def make_context(plan: NetworkPlan) -> ReleaseContext:
    """Return what is the same for all objects that a mode adds."""
    return ReleaseContext(
        plan.namespace, plan.release, None, plan.distro, plan.ros, pull_secrets=plan.pull_secrets
    )


def interface_script() -> str:
    """Return the text of the init container's script, a part of this package."""
    return files(__package__).joinpath(SCRIPT).read_text(encoding="utf-8")


def config_name(plan: NetworkPlan) -> str:
    """Return the name of the ConfigMap with the release's network files."""
    return f"{plan.release}-network"


def files_config(plan: NetworkPlan, texts: Mapping[str, str]) -> Object:
    """Return the ConfigMap with the release's network files.

    It stands in no pod template: whoever starts reads what is true then, and nobody restarts
    because a neighbour came.
    """
    return config_map(make_context(plan), config_name(plan), texts, part_of=plan.release)


def mount_files(plan: NetworkPlan) -> Wiring:
    """Return what lets a pod read the files as the ConfigMap has them."""
    volume = {"name": VOLUME, "configMap": {"name": config_name(plan)}}
    return Wiring(volumes=[volume], mounts=[mount()])


def render_at_start(
    plan: NetworkPlan, pod: PodIdentity, interface: str, missing: str, *, own_machine_id: bool
) -> Wiring:
    """Return what lets a pod start only with its interface, and read files with its address.

    Args:
        missing: what the init container says when the interface is not there.
        own_machine_id: give the container an /etc/machine-id that no other pod has.
    """
    address = plan.addresses.get(pod.name, "").partition("/")[0]
    words = [interface, missing, *([address] if address else [])]
    secure = pod.like.get("securityContext", {})
    init = {
        "name": INIT_NAME,
        "image": pod.image,
        **pod.like,
        "command": ["/bin/sh", f"{SOURCE_PATH}/{SCRIPT}", *words],
        "securityContext": {key: secure[key] for key in IDENTITY if key in secure} | HARMLESS,
        "volumeMounts": [
            {"name": SOURCE_VOLUME, "mountPath": SOURCE_PATH, "readOnly": True},
            {"name": VOLUME, "mountPath": FILES_PATH},
        ],
    }
    return Wiring(
        init_containers=[init],
        volumes=[
            {"name": SOURCE_VOLUME, "configMap": {"name": config_name(plan)}},
            {"name": VOLUME, "emptyDir": {}},
        ],
        mounts=[mount(), *([MACHINE_ID] if own_machine_id else [])],
    )


def mount() -> Object:
    """Return the mount of the files in the ROS container."""
    return {"name": VOLUME, "mountPath": FILES_PATH, "readOnly": True}
