"""One deploy of a release at a time: a Lease that its holder renews and that expires without it.

No clock is compared with another machine's: a Lease counts as dead when it is not renewed while we
watch it for its whole duration, or at once when its holder was a process of this machine that is
gone.
"""

from __future__ import annotations

import getpass
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, ConflictError, Interrupted, NotFoundError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter

DURATION = 15  # seconds without renewal after which a Lease is dead
RENEW = 5.0
LOOK = 0.5
PROCESS = "rigel-k8s/process"


@attrs.frozen
class Held:
    """A Lease that we hold; `lost` is set when it turns out that we do not any more."""

    lost: threading.Event = attrs.field(factory=threading.Event)

    def check(self) -> None:
        """Raise ClusterError where the Lease is lost."""
        if self.lost.is_set():
            raise ClusterError(
                "this deploy lost its Lease: another one may be under way",
                hint="see `rigel history`, then run it again",
            )


@contextmanager
def hold(
    cluster: Cluster,
    release: ReleaseId,
    report: Reporter,
    cancel: threading.Event,
    *,
    patience: float,
) -> Iterator[Held]:
    """Hold a release's Lease.

    Args:
        patience: seconds to wait for another deploy of the release; 0 fails at once.

    Raises:
        ClusterError: another deploy of the release is under way; names its holder.
        Interrupted: `cancel` was set while we waited.
    """
    ref = lease_ref(release)
    lease = acquire(cluster, ref, report, cancel, patience)
    mine, over = Held(), threading.Event()
    thread = threading.Thread(target=renew, args=(cluster, lease, mine, over), daemon=True)
    thread.start()
    try:
        yield mine
    finally:
        over.set()
        thread.join()
        if not mine.lost.is_set():
            with suppress(ClusterError):  # it expires by itself
                cluster.delete(ref, uid=lease["metadata"]["uid"])


def lease_ref(release: ReleaseId) -> ObjectRef:
    """Return the name of a release's Lease."""
    name = f"rigel.{release.name}"
    return ObjectRef("coordination.k8s.io/v1", "Lease", release.namespace, name)


def acquire(
    cluster: Cluster, ref: ObjectRef, report: Reporter, cancel: threading.Event, patience: float
) -> dict[str, Any]:
    """Return the Lease when it is ours."""
    deadline = time.monotonic() + patience
    while not cancel.is_set():
        try:
            return cluster.create(manifest(ref))
        except ConflictError:
            other = cluster.get(ref)
        dead = None if other is None else outlive(cluster, ref, other, report, cancel, deadline)
        if dead is None:
            continue
        with suppress(ConflictError, NotFoundError):  # another one was quicker: look again
            version = {"resourceVersion": dead["metadata"]["resourceVersion"]}
            return cluster.replace(manifest(ref, version))
    raise Interrupted("interrupted before anything was changed", hint="run the same command again")


def outlive(
    cluster: Cluster,
    ref: ObjectRef,
    other: dict[str, Any],
    report: Reporter,
    cancel: threading.Event,
    deadline: float,
) -> dict[str, Any] | None:
    """Wait for the end of another holder; return the Lease that a dead one has left, or None.

    Raises:
        ClusterError: the deadline is over before.
    """
    uid = other["metadata"]["uid"]
    now: dict[str, Any] | None = other
    version, seen, told = "", 0.0, False
    while now is not None and now["metadata"]["uid"] == uid and not cancel.is_set():
        if now["metadata"]["resourceVersion"] != version:
            version, seen = now["metadata"]["resourceVersion"], time.monotonic()
        alive = is_alive(now)
        if alive is False or (alive is None and time.monotonic() - seen >= DURATION):
            return now
        left = deadline - time.monotonic()
        if left <= 0:
            raise taken_error(ref, now)
        if not told:
            report.line(f"{describe(ref, now)}; waiting for its end, {left:.0f} s at most")
            told = True
        cancel.wait(min(LOOK, left))
        now = cluster.get(ref)
    return None


def taken_error(ref: ObjectRef, other: dict[str, Any]) -> ClusterError:
    """Return the error for a Lease that another deploy still holds."""
    return ClusterError(
        f"{describe(ref, other)}, and has not ended in time",
        hint="run it again later; --lock-timeout 30m waits longer",
    )


def describe(ref: ObjectRef, lease: dict[str, Any]) -> str:
    """Return who works on a release since when."""
    release = ref.name.removeprefix("rigel.")
    since = lease["spec"].get("acquireTime", "an unknown time")
    return f"release {release} is being changed by {holder(lease)} since {since}"


def bury(cluster: Cluster, lease: dict[str, Any], report: Reporter) -> None:
    """Remove a Lease whose holder was a process of this machine and is gone; leave any other.

    Why: an interrupted deploy that had nothing left to do but this takes no Lease when it is run
    again, and so would leave it for ever.
    """
    if is_alive(lease) is not False:
        return
    meta = lease["metadata"]
    ref = ObjectRef(lease["apiVersion"], lease["kind"], meta["namespace"], meta["name"])
    with suppress(ConflictError):  # someone else has taken it meanwhile
        if cluster.delete(ref, uid=meta["uid"]):
            report.line(f"removed the Lease of {holder(lease)}, which was interrupted")


def bury_left(cluster: Cluster, release: ReleaseId, report: Reporter) -> None:
    """Remove the Lease that a process of this machine left when it was killed, if there is one."""
    lease = cluster.get(lease_ref(release))
    if lease is not None:
        bury(cluster, lease, report)


def holder(lease: dict[str, Any]) -> str:
    """Return who holds a Lease."""
    return str(lease["spec"].get("holderIdentity") or "an unknown process")


def manifest(ref: ObjectRef, meta: dict[str, str] | None = None) -> dict[str, Any]:
    """Return the Lease that says that we hold it."""
    own = {"name": ref.name, "namespace": ref.namespace, "annotations": {PROCESS: process()}}
    return {
        "apiVersion": ref.api_version,
        "kind": ref.kind,
        "metadata": {**own, **(meta or {})},
        "spec": {
            "holderIdentity": f"{getpass.getuser()}@{socket.gethostname()}, process {os.getpid()}",
            "leaseDurationSeconds": DURATION,
            "acquireTime": timestamp(),
            "renewTime": timestamp(),
        },
    }


def renew(cluster: Cluster, lease: dict[str, Any], mine: Held, over: threading.Event) -> None:
    """Renew a Lease until it is given back; say so when it is lost."""
    meta = lease["metadata"]
    ref = ObjectRef(lease["apiVersion"], lease["kind"], meta["namespace"], meta["name"])
    version, renewed = meta["resourceVersion"], time.monotonic()
    while not over.wait(RENEW):
        body = {"metadata": {"resourceVersion": version}, "spec": {"renewTime": timestamp()}}
        try:
            version = cluster.patch(ref, body)["metadata"]["resourceVersion"]
            renewed = time.monotonic()
        except (ConflictError, NotFoundError):
            mine.lost.set()
            return
        except ClusterError:
            if time.monotonic() - renewed > DURATION:
                mine.lost.set()
                return


def timestamp() -> str:
    """Return the present time as Kubernetes' MicroTime."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def process() -> str:
    """Return what names this very process among all of this machine, "" where it cannot be told."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return (
            f"{boot} {Path('/proc/self/ns/pid').readlink()} {os.getpid()} {read_start(os.getpid())}"
        )
    except OSError:
        return ""


def read_start(pid: int) -> str:
    """Return when a process was started, in ticks since the machine was."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]


def is_alive(lease: dict[str, Any]) -> bool | None:
    """Whether a Lease's holder lives, None where it is not a process of this machine."""
    words = str((lease["metadata"].get("annotations") or {}).get(PROCESS, "")).split()
    own = process().split()
    if len(words) != 4 or words[:2] != own[:2]:
        return None
    try:
        return read_start(int(words[2])) == words[3]
    except OSError:
        return False
