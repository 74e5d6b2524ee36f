"""A Deployment while one of its nodes is developed, or replaced by another program; pure.

The container's line gets dev.sh before it, which starts the program again in the same pod. There is
one such pod, which takes over from no other and hands over to none.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
from typing import Any

from rigel_k8s.errors import UserError
from rigel_k8s.objects.marks import (
    DEVELOPMENT_ANNOTATION,
    JOINED_ANNOTATION,
    NAME_LABEL,
    RELEASE_LABEL,
)
from rigel_k8s.objects.pods import GATE_PORT, MASTER_PORT, SCRIPTS_PATH, Object
from rigel_k8s.objects.refs import Manifest

#: A directory in memory: what dev.sh reads, and what `rigel dev` needs beside the files.
FOLDER = "/run/rigel-dev"
REQUESTS = f"{FOLDER}/requests"
VOLUME = "rigel-dev"
#: By these variables a pod hands over.
HAND_OVER = ("RIGEL_K8S_PEERS", "RIGEL_K8S_TOGETHER", "RIGEL_K8S_WORKLOAD")


def wrap_deployment(
    manifest: Manifest,
    name: str,
    note: str,
    synced: Collection[str] = (),
    copied: Collection[str] = (),
) -> Object:
    """Return a Deployment in which the program of one container is developed.

    Args:
        name: of the container.
        note: what is developed, by whom, and since when; its new pod has it, too.
        synced: folders of the container that are copied to. One that `files` mounts there, and that
            cannot be written, is an empty one instead.
        copied: paths of the files that are copied there. What is mounted read-only in a synced
            folder at such a path, or above it, is not mounted.

    Raises:
        UserError: what the container runs is not in the Deployment.
    """
    made: Object = copy.deepcopy(dict(manifest))
    spec, template = made["spec"], made["spec"]["template"]
    for meta in (made["metadata"], template.setdefault("metadata", {})):
        meta["annotations"] = {**(meta.get("annotations") or {}), DEVELOPMENT_ANNOTATION: note}
    spec["strategy"] = {"type": "Recreate"}
    if "replicas" in spec:
        spec["replicas"] = 1
    pod = template["spec"]
    pod["volumes"] = [
        *pod.get("volumes", []),
        {"name": VOLUME, "emptyDir": {"medium": "Memory", "sizeLimit": "16Mi"}},
    ]
    for container in pod["containers"]:
        if "env" in container:
            container["env"] = [
                call_master(one) for one in container["env"] if one["name"] not in HAND_OVER
            ]
        if container["name"] == name:
            pod["volumes"] += replace_mounts(
                container, {path.rstrip("/") for path in synced}, copied
            )
            wrap_container(container, made["metadata"]["name"])
    return made


def replace_mounts(
    container: dict[str, Any], synced: Collection[str], copied: Collection[str]
) -> list[Object]:
    """Let read-only mounts give way to what is copied; return the volumes of synced folders.

    Raises:
        UserError: what is copied would be in one of them.
    """
    made: list[Object] = []
    kept = []
    for mount in container.get("volumeMounts", []):
        path = mount["mountPath"].rstrip("/")
        below = next((one for one in synced if one.startswith(f"{path}/")), None)
        if below and mount.get("readOnly"):
            hint = f"copy the whole folder: --sync DIR:{path}"
            raise UserError(f"{below} is in {path}, which is mounted read-only", hint=hint)
        if mount.get("readOnly") and path in synced:
            volume = f"{VOLUME}-{len(made)}"
            made.append({"name": volume, "emptyDir": {}})
            kept.append({"name": volume, "mountPath": mount["mountPath"]})
        elif not (
            mount.get("readOnly")
            and any(path.startswith(f"{folder}/") for folder in synced)
            and any(f"{file}/".startswith(f"{path}/") for file in copied)
        ):
            kept.append(mount)
    container["volumeMounts"] = kept
    return made


def put_to_sleep(manifest: Manifest, note: str) -> Object:
    """Return a Deployment without pods.

    Args:
        note: what takes its place, by whom, and since when.
    """
    made: Object = copy.deepcopy(dict(manifest))
    meta = made["metadata"]
    meta["annotations"] = {**(meta.get("annotations") or {}), DEVELOPMENT_ANNOTATION: note}
    made["spec"]["replicas"] = 0
    return made


def call_master(variable: dict[str, Any]) -> dict[str, Any]:
    """Return a variable; that of ROS 1 leads to the port where a name is taken at once."""
    if variable["name"] != "ROS_MASTER_URI" or "value" not in variable:
        return variable
    return {**variable, "value": variable["value"].replace(f":{GATE_PORT}", f":{MASTER_PORT}")}


def wrap_container(container: dict[str, Any], workload: str) -> None:
    """Put dev.sh before what a container runs: its `command`, else the args of its ENTRYPOINT."""
    key = "command" if container.get("command") else "args"
    line = container.get(key) or []
    if not line or line[0].startswith("-"):
        raise UserError(
            f"{workload} runs what its image names, which rigel cannot start again",
            hint="set `args` or `command` of the node in the Rigelfile, and deploy it",
        )
    container[key] = ["/bin/sh", f"{SCRIPTS_PATH}/dev.sh", REQUESTS, *line]
    container.pop("livenessProbe", None)
    mount = {"name": VOLUME, "mountPath": FOLDER}
    container["volumeMounts"] = [*container.get("volumeMounts", []), mount]


SCRIPT = f"{SCRIPTS_PATH}/join.py"
NAME = "rigel-join"
NETWORKS = "k8s.v1.cni.cncf.io/networks"
#: What the pod keeps of a node's: where it may run, and how it reaches registries and names.
OF_POD = (
    *("dnsPolicy", "dnsConfig", "hostAliases", "imagePullSecrets", "nodeSelector"),
    *("tolerations", "affinity", "runtimeClassName", "enableServiceLinks"),
)
#: Our scripts, and the files that describe the middleware.
VOLUMES = frozenset({"rigel-inpod", "rigel-network", "rigel-network-source"})
#: What the relay must be able to do: to take the address from the kernel, and to send frames.
CAPABILITIES = ("NET_ADMIN", "NET_RAW")


def make_pod(deployment: Manifest, name: str, *, by: str) -> Object:
    """Return the Pod that stands in the network as those of a Deployment do.

    Args:
        name: of the Pod.
        by: who joins, for an annotation.

    Raises:
        UserError: the Deployment's pods are in their machines' own network.
    """
    template = deployment["spec"]["template"]
    meta, spec = template["metadata"], template["spec"]
    if spec.get("hostNetwork"):
        raise UserError(
            "the nodes are in the network of their machines (network: host), not in one of pods",
            hint="connect this computer to that network, with the ROS_DOMAIN_ID or the"
            " ROS_MASTER_URI of the nodes (`rigel exec NODE -- env`)",
        )
    node = spec["containers"][0]
    annotations = meta.get("annotations") or {}
    kept = {key: annotations[key] for key in (NETWORKS,) if key in annotations}
    container = {
        "name": NAME,
        "image": node["image"],
        "imagePullPolicy": node.get("imagePullPolicy", "IfNotPresent"),
        "command": ["python3", SCRIPT, "hold"],
        "env": [call_master(one) for one in node.get("env") or []],
        "volumeMounts": [one for one in node["volumeMounts"] if one["name"] in VOLUMES],
        "securityContext": {
            "runAsUser": 0,
            "allowPrivilegeEscalation": False,
            "capabilities": {"drop": ["ALL"], "add": list(CAPABILITIES)},
        },
        "resources": {"requests": {"cpu": "50m", "memory": "32Mi"}},
    }
    pod = {key: copy.deepcopy(spec[key]) for key in OF_POD if key in spec}
    pod |= {
        "restartPolicy": "Never",
        "terminationGracePeriodSeconds": 1,
        "automountServiceAccountToken": False,
        "initContainers": [one for one in spec.get("initContainers") or [] if is_of_network(one)],
        "containers": [container],
        "volumes": [one for one in spec["volumes"] if one["name"] in VOLUMES],
    }
    labels = {RELEASE_LABEL: meta["labels"][RELEASE_LABEL], NAME_LABEL: NAME}
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {
            "name": name,
            "namespace": deployment["metadata"]["namespace"],
            "labels": labels,
            "annotations": {**kept, JOINED_ANNOTATION: by},
        },
        "spec": pod,
    }


def is_of_network(container: Object) -> bool:
    """Return whether an init container writes nothing but what describes the middleware."""
    return {one["name"] for one in container.get("volumeMounts") or []} <= VOLUMES
