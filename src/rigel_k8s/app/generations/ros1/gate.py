"""The gate in front of roscore: its container, the object with its state, and its rights."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.objects.pods import (
    GATE_CONTAINER,
    GATE_PORT,
    MASTER_NAME,
    MASTER_PORT,
    ROSCORE_PORT,
    SCRIPTS_PATH,
    Object,
    drop_empty,
    inpod_volume,
    service_account,
)
from rigel_k8s.objects.raw import containers_of
from rigel_k8s.objects.workloads import ReleaseContext, config_map

#: Where the gate's files are, so that Python finds `rigel_gate` from there.
PROGRAM_PATH = "/rigel-k8s-gate"
PACKAGE_PATH = f"{PROGRAM_PATH}/rigel_gate"
JOURNAL_PATH = "/rigel-k8s-memory"
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
MEMORY_NAME = f"{MASTER_NAME}-memory"
ACCOUNT_PATH = "/var/run/secrets/kubernetes.io/serviceaccount"
#: The objects that the role `edit` may not write.
KINDS = ("Role", "RoleBinding")
RIGHTS = (
    "roscore's gate has a Role of its own, which the role `edit` may not write: request the rights"
    " that `rigel rbac deployer` prints, or set `gate: false`"
)
#: 100,000 parameters take 73 MiB. A caller that sends or requests too much ends the gate, which
#: starts again with its state, and neither roscore nor another program of the machine.
RESOURCES = {"requests": {"memory": "32Mi"}, "limits": {"memory": "256Mi"}}
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


def gate_container(image: str, env: list[Object], release: str) -> Object:
    """Return the gate's container; it runs on the Python of roscore's image."""
    look = {"httpGet": {"path": "/ready", "port": MASTER_PORT}}
    return {
        "name": GATE_CONTAINER,
        "image": image,
        "command": ["python3", "-E", "-S", "-B", "-m", "rigel_gate"],
        "args": ["--journal", f"{JOURNAL_PATH}/journal", "--object", MEMORY_NAME],
        "workingDir": PROGRAM_PATH,
        "env": env,
        "ports": [
            {"name": "ros", "containerPort": MASTER_PORT},
            {"name": "hand-over", "containerPort": GATE_PORT},
        ],
        "resources": RESOURCES,
        "startupProbe": {**look, "periodSeconds": 1, "failureThreshold": 2**31 - 1},
        "readinessProbe": {**look, "periodSeconds": 10, "timeoutSeconds": 5},
        "volumeMounts": [
            inpod_volume(release)[1],
            *({"name": v["name"], "mountPath": path, **more} for v, path, more in mounts(release)),
        ],
    }


def mounts(release: str) -> Iterator[tuple[Object, str, Object]]:
    """Yield (volume, mount path, more of the mount) of what only the gate sees.

    Only the gate gets the service account's token, not roscore or nodes.
    """
    files = {"name": program_config(release), "defaultMode": 0o444}
    read_only = {"readOnly": True}
    yield {"name": "gate-program", "configMap": files}, PACKAGE_PATH, read_only
    yield {"name": "gate-journal", "emptyDir": {}}, JOURNAL_PATH, {}
    namespace = {"path": "namespace", "fieldRef": {"fieldPath": "metadata.namespace"}}
    sources = [
        {"serviceAccountToken": {"path": "token"}},
        {
            "configMap": {
                "name": "kube-root-ca.crt",
                "items": [{"key": "ca.crt", "path": "ca.crt"}],
            }
        },
        {"downwardAPI": {"items": [namespace]}},
    ]
    yield {"name": "gate-account", "projected": {"sources": sources}}, ACCOUNT_PATH, read_only


def program_config(release: str) -> str:
    """Return the name of the ConfigMap with the gate's files."""
    return f"{release}-gate"


def gate_objects(around: ReleaseContext, program: Mapping[str, str]) -> Iterator[Object]:
    """Yield what the gate needs in addition: its files, its state, the right to write it."""
    yield config_map(around, program_config(around.release), program, part_of=MASTER_NAME)
    yield {
        "apiVersion": "v1",
        "kind": "Secret",
        "type": "Opaque",
        "metadata": around.metadata(MEMORY_NAME, part_of=MASTER_NAME),
    }
    meta = around.metadata(MASTER_NAME)
    yield {
        "apiVersion": "v1",
        "kind": "ServiceAccount",
        "metadata": meta,
        "automountServiceAccountToken": False,
    }
    rule = {
        "apiGroups": [""],
        "resources": ["secrets"],
        "resourceNames": [MEMORY_NAME],
        "verbs": ["get", "patch"],
    }
    api = "rbac.authorization.k8s.io"
    yield {"apiVersion": f"{api}/v1", "kind": "Role", "metadata": meta, "rules": [rule]}
    yield {
        "apiVersion": f"{api}/v1",
        "kind": "RoleBinding",
        "metadata": meta,
        "roleRef": {"apiGroup": api, "kind": "Role", "name": MASTER_NAME},
        "subjects": [
            {"kind": "ServiceAccount", "name": MASTER_NAME, "namespace": around.namespace}
        ],
    }


def behind_gate(pod: Object, release: str) -> Object:
    """Return roscore's pod with a gate in front of it."""
    [roscore] = pod["containers"]
    mount = {"name": "gate-program", "mountPath": ROSCORE_PATH, "readOnly": True}
    own = {
        **{key: value for key, value in roscore.items() if key != "ports"},
        "args": [*KEPT, *LOOPBACK, *roscore["args"], "-p", str(ROSCORE_PORT)],
        "volumeMounts": [*roscore["volumeMounts"], mount],
    }
    return drop_empty(
        {
            **pod,
            "containers": [own, gate_container(roscore["image"], roscore["env"], release)],
            "volumes": [*pod["volumes"], *(volume for volume, _, _ in mounts(release))],
            **service_account(MASTER_NAME),
        }
    )
