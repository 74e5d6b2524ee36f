"""Multus' daemon on every machine, and its configuration."""

from __future__ import annotations

import json
from typing import Any

from rigel_k8s.network.multus.machines import (
    Machines,
    bringer,
    config_map,
    daemon_set,
    fields,
    host,
    keeper,
    mount,
    root_mounts,
    volumes,
)
from rigel_k8s.network.multus.rights import MULTUS

Object = dict[str, Any]

PROGRAMS = "/usr/src/multus-cni/bin"  # in Multus' image
CONFIG = "/etc/rigel-multus"
GENERATED = "/run/rigel-multus-generated"
#: The daemon removes and creates its socket's directory, so that directory cannot be a mount.
SOCKETS = "/run/rigel-network"
SOCKET_DIR = f"{SOCKETS}/multus"
HOST_ROOT = "/hostroot"

#: Directories of the machine that the daemon looks into: those of pods' networks (the runtime's),
#: of what it has attached, and of devices that pods were given.
DIRECTORIES = {
    "netns": "/run/netns",
    "attached": "/var/lib/cni/multus",
    "devices": "/run/k8s.cni.cncf.io",
    "kubelet": "/var/lib/kubelet",
}


def multus_daemon(
    machines: Machines, script: Object, image: str, plugins_image: str | None
) -> tuple[Object, Object]:
    """Return the daemon's ConfigMap and DaemonSet for the machines of one platform.

    Args:
        script: the ConfigMap with machine.sh.
        plugins_image: brings standard CNI programs that are missing there; None: none is missing.
    """
    config = config_map(
        machines.name_object("rigel-multus-config"),
        {"daemon-config.json": json.dumps(_configuration(machines), indent=2, sort_keys=True)},
    )
    env = {
        "PROGRAMS": "multus-shim passthru",
        "SOURCE": PROGRAMS,
        "GENERATED": GENERATED,
        "NEEDED": "macvlan static",
    }
    mounts = [mount("generated", GENERATED, read_only=True)]
    pod = {
        "hostPID": True,  # a runtime may name a pod's network /proc/PID/ns/net
        "initContainers": [bringer(machines, "multus", plugins_image)] if plugins_image else [],
        "containers": [
            _daemon(machines, image),
            keeper(machines, "multus", image, env, mounts),
        ],
        "volumes": [*volumes(machines), *_volumes(config["metadata"]["name"])],
    }
    return config, daemon_set(machines, MULTUS, pod, [config, script])


def _configuration(machines: Machines) -> Object:
    """Return the daemon's configuration; every primary network supports its version."""
    return {
        "chrootDir": HOST_ROOT,
        "cniVersion": "0.3.1",
        "logLevel": "verbose",
        "logToStderr": True,
        "binDir": machines.platform.bin_dir,
        "cniConfigDir": GENERATED,
        "multusAutoconfigDir": machines.platform.conf_dir,
        "multusConfigFile": "auto",
        "socketDir": SOCKET_DIR,
        "daemonSocketDir": SOCKET_DIR,
    }


def _daemon(machines: Machines, image: str) -> Object:
    look = {"command": ["/bin/sh", "-c", f"test -S {SOCKET_DIR}/multus.sock"]}
    answers = {"exec": look, "timeoutSeconds": 5}  # by default 1 s, too short for a busy machine
    return {
        "name": "multus",
        "image": image,
        "imagePullPolicy": "IfNotPresent",
        "command": [f"{PROGRAMS}/multus-daemon", f"-config={CONFIG}/daemon-config.json"],
        "env": fields(MULTUS_NODE_NAME="spec.nodeName"),
        # With upstream's 50Mi it is OOM-killed if many pods start at once. The programs that it
        # runs count too. No limit of CPU: a machine with a throttled daemon starts no pods.
        "resources": {"requests": {"cpu": "50m", "memory": "64Mi"}, "limits": {"memory": "512Mi"}},
        "securityContext": {"privileged": True},
        "startupProbe": {**answers, "periodSeconds": 1, "failureThreshold": 180},
        "readinessProbe": {**answers, "periodSeconds": 15},
        "terminationMessagePolicy": "FallbackToLogsOnError",
        "volumeMounts": [
            *root_mounts(machines.platform, read_only=True),
            mount("config", CONFIG, read_only=True),
            mount("generated", GENERATED),
            mount("sockets", SOCKETS),
            mount("machine", HOST_ROOT, mountPropagation="HostToContainer"),
            *(
                mount(n, path, mountPropagation="HostToContainer")
                for n, path in DIRECTORIES.items()
            ),
        ],
    }


def _volumes(config: str) -> list[Object]:
    return [
        {"name": "config", "configMap": {"name": config}},
        {"name": "generated", "emptyDir": {}},
        host("sockets", SOCKETS, "DirectoryOrCreate"),
        host("machine", "/"),
        *(host(name, path, "DirectoryOrCreate") for name, path in DIRECTORIES.items()),
    ]
