"""What every pod with ROS in it has: environment, probes, the stop hook, in-pod scripts.

The scripts' contract is docs/in-pod-scripts.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from rigel_k8s.manifests.commands import text_of, words
from rigel_k8s.manifests.options import EnvVar, Readiness
from rigel_k8s.manifests.overlay import plain

__all__ = [
    "MASTER_NAME",
    "MASTER_PORT",
    "MASTER_URI",
    "SCRIPTS_PATH",
    "Object",
    "compact",
    "environment",
    "inpod_volume",
    "probes",
    "scripts_config",
    "stop_hook",
]

Object = dict[str, Any]

SCRIPTS_PATH = "/rigel-k8s"
MASTER_NAME = "ros-master"
MASTER_PORT = 11311
MASTER_URI = f"http://{MASTER_NAME}:{MASTER_PORT}"

#: A probe that never gives up: a node may wait long for its hardware or its master.
FOR_EVER = 2**31 - 1
#: Seconds that the startup probe's one process looks, and that the kubelet gives it.
LOOK, LOOK_TIMEOUT = 8, 10


def compact(fields: Mapping[str, Any]) -> Object:
    """Return the fields that say something."""
    return {key: value for key, value in fields.items() if value not in (None, {}, [])}


def environment(
    master_uri: str | None,
    extra: Mapping[Any, Any] | Sequence[EnvVar] = (),
    *,
    namespace: str | None = None,
    host_network: bool = False,
) -> list[Object]:
    """Return the environment of a ROS 1 container; what the user says wins.

    ROS_IP makes a node advertise an address that other pods reach: a pod's name resolves nowhere.
    The rest makes rospy and roscpp log at once, and sets up ROS in a shell of `kubectl exec`.
    """
    address = "status.hostIP" if host_network else "status.podIP"
    own = dict(entries(extra))
    env: dict[str, Object] = {
        "ROS_MASTER_URI": {"value": master_uri},
        "ROS_IP": {"valueFrom": {"fieldRef": {"apiVersion": "v1", "fieldPath": address}}},
        "ROS_NAMESPACE": {"value": namespace},
        "PYTHONUNBUFFERED": {"value": "1"},
        "ROSCONSOLE_STDOUT_LINE_BUFFERED": {"value": "1"},
        "PROMPT_COMMAND": {"value": f". {SCRIPTS_PATH}/rc.sh"},
    }
    if "ROS_HOSTNAME" in own:
        del env["ROS_IP"]  # ROS_HOSTNAME wins in ROS; two would mislead the reader
    env |= own
    return [{"name": name, **source} for name, source in env.items() if said(source)]


def said(source: Mapping[str, Any]) -> bool:
    """Return whether a variable has a value at all (the empty text is one)."""
    return any(value is not None for value in source.values())


def entries(extra: Mapping[Any, Any] | Sequence[EnvVar]) -> Iterator[tuple[str, Object]]:
    """Yield the user's variables, written as a mapping or as Kubernetes writes them."""
    if isinstance(extra, Mapping):
        for name, value in extra.items():
            yield str(name), {"value": text_of(value)}
        return
    for item in extra:
        if item.value_from is not None:
            yield str(item.name), {"valueFrom": plain(item.value_from)}
        else:
            yield str(item.name), {"value": "" if item.value is None else text_of(item.value)}


def script(name: str, *arguments: str) -> Object:
    """Return a call of an in-pod script."""
    return {"exec": {"command": ["/bin/sh", f"{SCRIPTS_PATH}/{name}", *arguments]}}


def probes(
    readiness: Readiness | str | None, *, kind: Literal["node", "master"] = "node"
) -> Object:
    """Return a container's probes: one that sees the start at once, a rare one afterwards.

    Args:
        readiness: a command or file of the user's, "none", or "ros" and None for ROS' own.
        kind: what the ROS probe asks.
    """
    if readiness == "none":
        return {}
    own = readiness if isinstance(readiness, Readiness) else Readiness()
    if own.command is None and own.file is None:
        start = {**script("ready.sh", kind, "--wait", str(LOOK)), "timeoutSeconds": LOOK_TIMEOUT}
        check = script("ready.sh", kind)
    else:
        check = {"exec": {"command": own_command(own)}}
        start = {**check, "timeoutSeconds": int(own.probe_timeout_seconds or 5)}
    start |= {"periodSeconds": 1, "failureThreshold": FOR_EVER}
    if own.initial_delay_seconds:
        start["initialDelaySeconds"] = int(own.initial_delay_seconds)
    return {"startupProbe": start, "readinessProbe": {**check, **timing(own)}}


def own_command(own: Readiness) -> list[str]:
    """Return the user's own check."""
    return words(own.command) if own.command is not None else ["test", "-e", str(own.file)]


def timing(own: Readiness) -> Object:
    """Return the readiness probe's numbers: unready within 30 s, one process start in 10 s."""
    return {
        "periodSeconds": int(own.period_seconds or 10),
        "timeoutSeconds": int(own.probe_timeout_seconds or 5),
        "failureThreshold": int(own.failure_threshold or 2),
    }


def stop_hook(grace: int | None = None) -> Object:
    """Return the lifecycle that ends ROS processes with SIGINT: many of them ignore SIGTERM.

    Args:
        grace: seconds that the pod may take to end; the hook is done shortly before.
    """
    bound = [] if grace is None else [str(max(1, grace - 2))]
    return {"preStop": script("stop.sh", *bound)}


def scripts_config(release: str) -> str:
    """Return the name of the ConfigMap with the in-pod scripts."""
    return f"{release}-inpod"


def inpod_volume(release: str) -> tuple[Object, Object]:
    """Return (volume, mount) of the in-pod scripts."""
    volume = {
        "name": "rigel-inpod",
        "configMap": {"name": scripts_config(release), "defaultMode": 0o555},
    }
    return volume, {"name": "rigel-inpod", "mountPath": SCRIPTS_PATH, "readOnly": True}
