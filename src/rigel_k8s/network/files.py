"""Files that a mode adds to pods: a ConfigMap of the release, and what an init container makes.

An init container is needed if a file contains the pod's own address, and if a pod must not start
without its interface. It runs the pod's own image and needs only a shell.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Any

import attrs

from rigel_k8s.network.dds import (
    FILES_PATH,
    fastdds_profiles,
    fastdds_variables,
    reads_transports,
    transports,
    uses,
)
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.workloads import ReleaseContext, config_map

Object = dict[str, Any]

SCRIPT = "interface.sh"
#: Where the init container finds the files of the ConfigMap.
SOURCE_PATH = "/rigel-k8s-network-source"
SOURCE_VOLUME, VOLUME = "rigel-network-source", "rigel-network"
INIT_NAME = "rigel-network"

#: The user that a container runs as; a namespace may require these fields of init containers too.
IDENTITY = ("runAsUser", "runAsGroup", "runAsNonRoot", "seccompProfile", "seLinuxOptions")
#: It reads /proc and writes to an emptyDir.
HARMLESS = {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}

#: Fast DDS 3 takes two programs with the same machine-id for neighbors on one machine, and all pods
#: of an image have the same id. If only one interface is allowed, it sends neighbors nothing.
MACHINE_ID = {
    "name": VOLUME,
    "mountPath": "/etc/machine-id",
    "subPath": "machine-id",
    "readOnly": True,
}


def make_context(plan: NetworkPlan) -> ReleaseContext:
    """Return the context that all objects of a mode share."""
    return ReleaseContext(
        plan.namespace, plan.release, plan.distro, plan.ros, pull_secrets=plan.pull_secrets
    )


def interface_script() -> str:
    """Return the text of the init container's script, a part of this package."""
    return files(__package__).joinpath(SCRIPT).read_text(encoding="utf-8")


def config_name(plan: NetworkPlan) -> str:
    """Return the name of the ConfigMap with the release's network files."""
    return f"{plan.release}-network"


def files_config(plan: NetworkPlan, texts: Mapping[str, str]) -> Object:
    """Return the ConfigMap with the release's network files.

    It is not part of any pod template: a pod reads it when it starts, and does not restart when
    another one is added.
    """
    return config_map(make_context(plan), config_name(plan), texts, part_of=plan.release)


def mount_files(plan: NetworkPlan) -> Wiring:
    """Return the wiring of a pod that reads the files as the ConfigMap has them."""
    volume = {"name": VOLUME, "configMap": {"name": config_name(plan)}}
    return Wiring(volumes=[volume], mounts=[mount()])


def render_at_start(
    plan: NetworkPlan, pod: PodIdentity, interface: str, missing: str, *, own_machine_id: bool
) -> Wiring:
    """Return the wiring of a pod that starts only with its interface.

    It reads files that contain the address of the interface.

    Args:
        missing: what the init container prints if the interface is missing.
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


def wire_neighbor(plan: NetworkPlan, pod: PodIdentity) -> Wiring:
    """Return what a pod on its machine's network gets."""
    if not uses(plan, "fastdds"):
        return Wiring()
    if reads_transports(plan):
        return Wiring(env=transports(plan, pod))
    return attrs.evolve(mount_files(plan), env=fastdds_variables(plan, pod))


def neighbor_files(plan: NetworkPlan) -> Iterator[Object]:
    """Yield the ConfigMap with the profile, if these pods need it."""
    if uses(plan, "fastdds") and not reads_transports(plan):
        yield files_config(plan, fastdds_profiles(plan))
