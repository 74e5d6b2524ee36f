"""The Multus daemon on one machine, and where in its container the machine's files are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.objects.facts import is_ready

Manifest = Mapping[str, Any]

#: Where CNI programs are on machines of a usual kind.
USUAL = "/opt/cni/bin"
#: Usual names of Multus' DaemonSet, for images that were renamed.
NAMES = ("multus", "kube-multus-ds", "rigel-multus")


@attrs.frozen
class Daemon:
    """A pod of Multus, in which a script can examine its machine.

    Attributes:
        state: why it is not ready, "" if it is.
        root: where the machine's root directory is mounted, "" if it is not.
        directories: where in the container the machine's CNI programs are.
    """

    node: str
    namespace: str
    pod: str
    container: str
    state: str = ""
    root: str = ""
    directories: tuple[str, ...] = ()


def is_multus(daemon_set: Manifest) -> bool:
    """Return whether a DaemonSet runs Multus, independent of its installer and its name."""
    containers = daemon_set["spec"]["template"]["spec"]["containers"]
    return daemon_set["metadata"]["name"] in NAMES or any(map(_runs_multus, containers))


def _runs_multus(container: Manifest) -> bool:
    last = container.get("image", "").partition("@")[0].rpartition("/")[2]
    return "multus" in last.partition(":")[0]


def daemon(pod: Manifest) -> Daemon:
    """Return the facts about a pod of Multus that are needed to examine its machine."""
    spec, meta = pod["spec"], pod["metadata"]
    container = next(filter(_runs_multus, spec["containers"]), spec["containers"][0])
    paths = {
        volume["name"]: volume["hostPath"]["path"]
        for volume in spec.get("volumes") or []
        if "hostPath" in volume
    }
    mounts = {
        paths[m["name"]]: m["mountPath"]
        for m in container.get("volumeMounts") or []
        if m["name"] in paths and not m.get("subPath")
    }
    root = mounts.get("/", "")
    return Daemon(
        node=spec.get("nodeName", ""),
        namespace=meta["namespace"],
        pod=meta["name"],
        container=container["name"],
        state=_state(pod),
        root=root,
        directories=tuple(_directories(spec, mounts, root)),
    )


def _directories(spec: Manifest, mounts: Mapping[str, str], root: str) -> Iterator[str]:
    """Yield the directories of the machine's CNI programs: our own pods' variable, or the mounts.

    If two paths lead to one directory, that below the machine's root is used: links resolve there.
    """
    variables = [v for c in spec["containers"] for v in c.get("env") or []]
    known = [v["value"] for v in variables if v["name"] == "BIN_DIR" and v.get("value")]
    mounted = [path for path in mounts if path.rstrip("/").endswith(("/bin", "/data/cni"))]
    for path in known or mounted or [USUAL]:
        if root:
            yield root.rstrip("/") + path
        elif path in mounts:
            yield mounts[path]


def _state(pod: Manifest) -> str:
    """Return why a pod is not ready, "" if it is."""
    status = pod.get("status") or {}
    if is_ready(pod):
        return ""
    for one in [
        *(status.get("initContainerStatuses") or []),
        *(status.get("containerStatuses") or []),
    ]:
        waiting = (one.get("state") or {}).get("waiting") or {}
        if waiting.get("reason"):
            return str(waiting["reason"])
    return str(status.get("phase") or "not ready")
