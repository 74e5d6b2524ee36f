"""The gate in front of roscore: its container, the object with its state, and its rights.

They are in gate.yaml, apart from what differs from release to release.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from typing import Any

import yaml

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.objects.overlay import containers_of
from rigel_k8s.objects.pods import (
    MASTER_NAME,
    ROSCORE_PORT,
    SCRIPTS_PATH,
    Object,
    drop_empty,
    inpod_volume,
    service_account,
)
from rigel_k8s.objects.workloads import ReleaseContext, config_map
from rigel_k8s.yaml_text import Loader

#: Where the gate's files are, so that Python finds `rigel_gate` from there.
PROGRAM_PATH = "/rigel-k8s-gate"
PACKAGE_PATH = f"{PROGRAM_PATH}/rigel_gate"
#: Where roscore finds roscore.xml, the list of what it starts.
ROSCORE_PATH = "/rigel-k8s-roscore"
#: Starts roscore with a master that listens on the loopback, where only this pod reaches it. The
#: variables are not in the container's environment, which `rigel exec` passes to tools that other
#: pods must reach.
LOOPBACK = [
    *("env", "-u", "ROS_HOSTNAME", "ROS_IP=127.0.0.1"),
    *("RIGEL_K8S_POD_IP=$(ROS_IP)", f"ROS_ETC_DIR={ROSCORE_PATH}"),
]
#: Restarts roscore while its container keeps running: callers reach the gate meanwhile.
KEPT = ["/bin/sh", f"{SCRIPTS_PATH}/keep.sh"]
#: The objects that the role `edit` may not write.
KINDS = ("Role", "RoleBinding")
RIGHTS = (
    "roscore's gate has a Role of its own, which the role `edit` may not write: request the rights"
    " that `rigel rbac deployer` prints, or set `gate: false`"
)
#: The ROS distributions whose images have the Python that the gate needs, 3.8.
DISTROS = ("noetic",)


def has_gate(options: OrchestrationOptions, distro: str) -> bool:
    """Return whether roscore is behind a gate; the release is known to have a roscore."""
    if options.gate is not None:
        return options.gate
    return distro in DISTROS and not replaces_roscore(options.additional_k8s_params.ros_master)


def replaces_roscore(params: Mapping[str, Any]) -> bool:
    """Return whether the user sets what the master's container runs, and its port."""
    return any({"command", "args", "ports"} & set(one) for one in containers_of(params))


def remedies_of(made: Iterable[Object]) -> dict[str, str]:
    """Return what to do if the objects of a gate may not be written, by their kind."""
    return {item["kind"]: RIGHTS for item in made if item["kind"] in KINDS}


def load() -> Object:
    """Return gate.yaml as plain data of the caller's own."""
    text = files(__package__).joinpath("gate.yaml").read_text(encoding="utf-8")
    found: Object = yaml.load(text, Loader)
    return found


def gate_objects(release: ReleaseContext, program: Mapping[str, str]) -> Iterator[Object]:
    """Yield what the gate needs in addition: its files, its state, the right to write it."""
    yield config_map(release, f"{release.release}-gate", program, part_of=MASTER_NAME)
    for item in load()["objects"]:
        for subject in item.get("subjects", ()):
            subject["namespace"] = release.namespace
        yield item | {"metadata": release.metadata(item["metadata"]["name"], part_of=MASTER_NAME)}


def behind_gate(pod: Object, release: str) -> Object:
    """Return roscore's pod with a gate in front of it."""
    [roscore] = pod["containers"]
    file = load()
    gate, volumes = file["container"], file["volumes"]
    gate |= {"image": roscore["image"], "env": roscore["env"]}
    gate["volumeMounts"].insert(0, inpod_volume(release)[1])
    volumes[0]["configMap"]["name"] = f"{release}-gate"
    mount = {"name": volumes[0]["name"], "mountPath": ROSCORE_PATH, "readOnly": True}
    own = {
        **{key: value for key, value in roscore.items() if key != "ports"},
        "args": [*KEPT, *LOOPBACK, *roscore["args"], "-p", str(ROSCORE_PORT)],
        "volumeMounts": [*roscore["volumeMounts"], mount],
    }
    return drop_empty(
        {
            **pod,
            "containers": [own, gate],
            "volumes": [*pod["volumes"], *volumes],
            **service_account(MASTER_NAME),
        }
    )
