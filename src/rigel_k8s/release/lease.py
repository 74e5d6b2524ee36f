"""The Lease of a release: an object that names the process that changes the release now.

No clock is compared with another machine's. Whether a holder on this machine still runs is visible
at once. Any other holder counts as ended if its Lease is not renewed while it is watched for
DURATION (locking.py).
"""

from __future__ import annotations

import getpass
import os
import socket
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import ReleaseId

DURATION = 15  # seconds without renewal after which a Lease counts as abandoned
PROCESS = "rigel-k8s/process"


def lease_ref(release: ReleaseId) -> ObjectRef:
    """Return the name of a release's Lease."""
    name = f"rigel.{release.name}"
    return ObjectRef("coordination.k8s.io/v1", "Lease", release.namespace, name)


def manifest(ref: ObjectRef, meta: dict[str, str] | None = None) -> dict[str, Any]:
    """Return the Lease that names us as its holder."""
    own = {"name": ref.name, "namespace": ref.namespace, "annotations": {PROCESS: process()}}
    return {
        "apiVersion": ref.api_version,
        "kind": ref.kind,
        "metadata": {**own, **(meta or {})},
        "spec": {
            "holderIdentity": f"{name_user()}, process {os.getpid()}",
            "leaseDurationSeconds": DURATION,
            "acquireTime": timestamp(),
            "renewTime": timestamp(),
        },
    }


def name_user() -> str:
    """Return who runs this process, and where: user@machine."""
    return f"{getpass.getuser()}@{socket.gethostname()}"


def describe(ref: ObjectRef, lease: dict[str, Any]) -> str:
    """Return which process changes a release, and since when."""
    release = ref.name.removeprefix("rigel.")
    since = lease["spec"].get("acquireTime", "an unknown time")
    return f"release {release} is being changed by {holder(lease)} since {since}"


def holder(lease: dict[str, Any]) -> str:
    """Return the holder of a Lease."""
    return str(lease["spec"].get("holderIdentity") or "an unknown process")


def is_same_holder(lease: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two states of a Lease have the same holder, which took it at the same time."""
    return is_taken_by(lease, other) and lease["metadata"]["uid"] == other["metadata"]["uid"]


def is_taken_by(lease: dict[str, Any], sent: dict[str, Any]) -> bool:
    """Whether a Lease was made from a manifest: same process, same time."""
    keys = ("holderIdentity", "acquireTime")
    return all(lease["spec"].get(key) == sent["spec"].get(key) for key in keys)


def timestamp() -> str:
    """Return the present time as Kubernetes' MicroTime."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def process() -> str:
    """Return what identifies this process on this machine, "" if that is not available."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return (
            f"{boot} {Path('/proc/self/ns/pid').readlink()} {os.getpid()} {read_start(os.getpid())}"
        )
    except OSError:
        return ""


def read_start(pid: int) -> str:
    """Return when a process was started, in ticks since the machine's start."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]


def is_alive(lease: dict[str, Any]) -> bool | None:
    """Whether a Lease's holder runs, None if it is not a process of this machine."""
    words = str((lease["metadata"].get("annotations") or {}).get(PROCESS, "")).split()
    own = process().split()
    if len(words) != 4 or words[:2] != own[:2]:
        return None
    try:
        return read_start(int(words[2])) == words[3]
    except (OSError, ValueError):
        return False
