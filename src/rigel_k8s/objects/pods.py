"""What every pod with ROS in it has: probes, tolerations, the stop hook, in-pod scripts, logs.

The scripts' contract is src/rigel_inpod/README.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rigel_k8s.objects.podoptions import Readiness, Toleration
from rigel_k8s.objects.text import split_words

Object = dict[str, Any]

SCRIPTS_PATH = "/rigel-k8s"
#: The container that kubectl uses by default in a pod with several.
DEFAULT_CONTAINER = "kubectl.kubernetes.io/default-container"
#: Where ROS 2 writes its log files: rcl needs a directory that every user can write to.
LOG_PATH = "/rigel-k8s-logs"
MASTER_NAME = "ros-master"
MASTER_PORT = 11311
MASTER_URI = f"http://{MASTER_NAME}:{MASTER_PORT}"
#: The port for the calls of nodes that hand over their names, and that of roscore behind the gate.
GATE_PORT, ROSCORE_PORT = 11310, 11312
GATE_CONTAINER, MASTER_CONTAINER = "gate", "ros-master-container"

#: A probe that never gives up: a node may wait a long time for its hardware or its master.
FOR_EVER = 2**31 - 1
#: Seconds that the one process of the startup probe watches.
LOOK = 8
#: Seconds that the kubelet gives a probe's process. On a busy machine a shell and Python take many
#: to start; a probe that finds a problem reports it long before.
PROBE_TIMEOUT = 30
#: A robot that loses its network keeps its pods: without these they are evicted after 300 s.
STAY = ("node.kubernetes.io/not-ready", "node.kubernetes.io/unreachable")


def drop_empty(fields: Mapping[str, Any]) -> Object:
    """Return the fields that are not empty."""
    return {key: value for key, value in fields.items() if value not in (None, {}, [])}


def script(name: str, *arguments: str) -> Object:
    """Return a call of an in-pod script."""
    return {"exec": {"command": ["/bin/sh", f"{SCRIPTS_PATH}/{name}", *arguments]}}


def find_container(spec: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the container of a pod that has the in-pod scripts."""
    for container in spec.get("containers") or []:
        if any(m.get("mountPath") == SCRIPTS_PATH for m in container.get("volumeMounts") or []):
            return container  # type: ignore[no-any-return]
    return None


def probes(readiness: Readiness | str | None, asked: Sequence[str]) -> Object:
    """Return a container's probes: one that notices the start at once, then an infrequent one.

    Args:
        readiness: a command, file or port of the user's, "none", or a word and None for ROS' own.
        asked: what the in-pod script is asked then.
    """
    if readiness == "none":
        return {}
    own = readiness if isinstance(readiness, Readiness) else Readiness()
    if own.port is not None:
        check: Object = {"tcpSocket": {"port": int(own.port)}}
        start = {**check, "timeoutSeconds": int(own.probe_timeout_seconds or PROBE_TIMEOUT)}
    elif not own.own_checks:
        look = script("ready.sh", *asked, "--wait", str(LOOK))
        start = {**look, "timeoutSeconds": PROBE_TIMEOUT}
        check = script("ready.sh", *asked)
    else:
        file = ["test", "-e", str(own.file)]
        check = {"exec": {"command": file if own.command is None else split_words(own.command)}}
        start = {**check, "timeoutSeconds": int(own.probe_timeout_seconds or PROBE_TIMEOUT)}
    start |= {"periodSeconds": 1, "failureThreshold": FOR_EVER}
    if own.initial_delay_seconds:
        start["initialDelaySeconds"] = int(own.initial_delay_seconds)
    # Unready within 30 s, at the cost of one process start in 10 s.
    timing = {
        "periodSeconds": int(own.period_seconds or 10),
        "timeoutSeconds": int(own.probe_timeout_seconds or PROBE_TIMEOUT),
        "failureThreshold": int(own.failure_threshold or 2),
    }
    return {"startupProbe": start, "readinessProbe": {**check, **timing}}


def tolerations(asked: Sequence[Toleration], *, pinned: bool) -> list[Object]:
    """Return the pod's tolerations; a pod pinned to a machine stays when its network fails."""
    result = [describe_toleration(item) for item in asked]
    if pinned:
        result += [{"key": key, "operator": "Exists", "effect": "NoExecute"} for key in STAY]
    return result


def describe_toleration(item: Toleration) -> Object:
    fields = {
        "key": str(item.key) if item.key else None,
        "operator": item.operator or ("Exists" if item.value is None else "Equal"),
        "value": str(item.value) if item.value is not None else None,
        "effect": item.effect,
        "tolerationSeconds": int(item.seconds) if item.seconds is not None else None,
    }
    return drop_empty(fields)


def stays(pod: Mapping[str, Any]) -> bool:
    """Return whether a pod's spec keeps it forever on a machine that Kubernetes cannot reach."""
    return any(
        one.get("key") in (STAY[1], None)
        and one.get("operator") == "Exists"
        and one.get("effect") in ("NoExecute", None)
        and one.get("tolerationSeconds") is None
        for one in pod.get("tolerations") or []
    )


def service_account(name: str | None) -> Object:
    """Return a pod's service account, under both of its names.

    The API server copies one into the other. When a Deployment that had only one loses it, the
    copy stays, since no one owns it, and its pods still need the account.
    """
    return {"serviceAccountName": name, "serviceAccount": name}


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


def log_volume() -> tuple[Object, Object]:
    """Return (volume, mount) of the directory for ROS 2's log files."""
    return {"name": "rigel-logs", "emptyDir": {}}, {"name": "rigel-logs", "mountPath": LOG_PATH}
