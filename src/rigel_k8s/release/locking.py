"""One deploy of a release at a time: take its Lease, renew it, wait for another holder's end."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, ConflictError, Interrupted, NotFoundError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.lease import (
    DURATION,
    describe,
    holder,
    is_alive,
    lease_ref,
    manifest,
    timestamp,
)
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter

RENEW = 5.0
LOOK = 0.5


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
