"""One deploy of a release at a time: take its Lease, renew it, wait for another holder's end.

A process that waits for a Lease takes it if it was not renewed for DURATION. So a holder writes
only within that time after a renewal, and renews it first if the time is over: another deploy may
have begun while an API server was unreachable or a machine slept.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, ConflictError, Interrupted, NotFoundError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.lease import (
    DURATION,
    describe,
    holder,
    is_alive,
    is_same_holder,
    is_taken_by,
    lease_ref,
    manifest,
    timestamp,
)
from rigel_k8s.release.types import DeployOptions, ReleaseId
from rigel_k8s.report import Reporter

RENEW = 5.0
SURE = DURATION - RENEW  # seconds after a renewal in which no one else can have taken the Lease
LOOK = 0.5


@attrs.define(eq=False)
class Held:
    """A Lease that we hold.

    Attributes:
        lease: as the last renewal left it.
        renewed: when the request of that renewal was sent.
        lost: set when the Lease turns out to be no longer ours.
        successor: who has it then and since when, or that it was removed.
    """

    cluster: Cluster
    lease: dict[str, Any]
    renewed: float = attrs.field(factory=time.monotonic)
    lost: threading.Event = attrs.field(factory=threading.Event)
    successor: str = ""
    lock: Any = attrs.field(factory=threading.RLock)
    renewing: bool = False

    @property
    def ref(self) -> ObjectRef:
        """The Lease's reference."""
        return ref_of(self.lease)

    def check(self) -> None:
        """Raise ClusterError if the Lease is known to be lost; sends nothing."""
        if self.lost.is_set():
            raise ClusterError(
                f"stopped because its Lease is lost: {self.successor}",
                hint="see `rigel history`, then run it again",
            )

    def confirm(self) -> None:
        """Return when the Lease is certainly ours; call it before each write.

        Raises:
            ClusterError: it is lost, or the API server does not answer.
        """
        if not self.is_sure():
            with self.lock:
                if self.renewing:  # this very thread: the renewal is a write that is sent again
                    return
                if not self.is_sure():
                    self.renew()
        self.check()

    def is_sure(self) -> bool:
        """Whether the last renewal is so recent that no one else can have taken the Lease."""
        return time.monotonic() - self.renewed < SURE

    def renew(self) -> None:
        """Renew the Lease, or note that it is lost.

        Raises:
            ClusterError: the API server does not answer or refuses.
        """
        with self.lock:
            sent, version = time.monotonic(), self.lease["metadata"]["resourceVersion"]
            body = {"metadata": {"resourceVersion": version}, "spec": {"renewTime": timestamp()}}
            self.renewing = True
            try:
                self.lease, self.renewed = self.cluster.patch(self.ref, body), sent
            except (ConflictError, NotFoundError):
                self.look_again()
            finally:
                self.renewing = False

    def look_again(self) -> None:
        """Note that the Lease is lost; renew it again if only our own renewal has changed it.

        The time when that was carried out is unknown, so it does not count.
        """
        now = self.cluster.get(self.ref)
        if now is not None and is_same_holder(now, self.lease):
            self.lease = now
            self.renew()
            return
        removed = f"another process has removed {self.ref}"
        self.successor = removed if now is None else describe(self.ref, now)
        self.lost.set()


@contextmanager
def hold(cluster: Cluster, release: ReleaseId, options: DeployOptions) -> Iterator[Held]:
    """Hold a release's Lease.

    Args:
        options: `lock_limit` are the seconds to wait for another deploy of the release; 0 fails at
            once.

    Raises:
        ClusterError: another deploy of the release is in progress; names its holder.
        Interrupted: `cancel` was set while we waited.
    """
    mine = acquire(cluster, lease_ref(release), options)
    over = threading.Event()
    thread = threading.Thread(target=keep_renewing, args=(mine, over), daemon=True)
    thread.start()
    try:
        with cluster.guard_writes(mine.confirm):
            yield mine
    finally:
        over.set()
        thread.join()
        with suppress(ClusterError):  # another process has it by now, or it expires
            remove(cluster, mine.lease)


def acquire(cluster: Cluster, ref: ObjectRef, options: DeployOptions) -> Held:
    """Return the Lease when it is ours.

    A conflict may be about a Lease that an earlier request of ours has made.
    """
    deadline = time.monotonic() + options.lock_limit
    while not options.cancel.is_set():
        wanted, sent = manifest(ref), time.monotonic()
        try:
            return Held(cluster, cluster.create(wanted), sent)
        except ConflictError:
            other = cluster.get(ref)
        if other is not None and is_taken_by(other, wanted):
            return Held(cluster, other, sent)
        dead = None if other is None else outlive(cluster, other, options, deadline)
        if dead is None:
            continue
        with suppress(ConflictError, NotFoundError):  # another one was faster: look again
            version = {"resourceVersion": dead["metadata"]["resourceVersion"]}
            sent = time.monotonic()
            return Held(cluster, cluster.replace(manifest(ref, version)), sent)
    raise Interrupted("interrupted before anything was changed", hint="run the same command again")


def outlive(
    cluster: Cluster, other: dict[str, Any], options: DeployOptions, deadline: float
) -> dict[str, Any] | None:
    """Wait for another holder to end; return the Lease that a dead one has left, or None.

    While an answer took long, the holder may have got none either: then its time begins again.

    Raises:
        ClusterError: the deadline is over first.
    """
    ref, uid = ref_of(other), other["metadata"]["uid"]
    now: dict[str, Any] | None = other
    version, seen, reported = "", 0.0, False
    while now is not None and now["metadata"]["uid"] == uid and not options.cancel.is_set():
        if now["metadata"]["resourceVersion"] != version:
            version, seen = now["metadata"]["resourceVersion"], time.monotonic()
        alive = is_alive(now)
        if alive is False or (alive is None and time.monotonic() - seen >= DURATION):
            return now
        left = deadline - time.monotonic()
        if left <= 0:
            raise ClusterError(
                f"{describe(ref, now)}, and has not ended in time",
                hint="run it again later; --lock-timeout 30m waits longer",
            )
        if not reported:
            options.report.line(f"{describe(ref, now)}; waiting for its end, {left:.0f} s at most")
            reported = True
        options.cancel.wait(min(LOOK, left))
        asked = time.monotonic()
        now = cluster.get(ref)
        if time.monotonic() - asked > RENEW:
            version = ""
    return None


def bury(cluster: Cluster, lease: dict[str, Any], report: Reporter) -> None:
    """Remove a Lease whose holder was a process of this machine and has ended; leave any other.

    Why: an interrupted deploy that had nothing else left to do takes no Lease when it is run again,
    and so would leave this one forever.
    """
    if is_alive(lease) is not False:
        return
    with suppress(ConflictError):  # another process has taken it meanwhile
        if remove(cluster, lease):
            report.line(f"removed the Lease of {holder(lease)}, which was interrupted")


def remove(cluster: Cluster, lease: dict[str, Any]) -> bool:
    """Delete a Lease, and return whether it existed; Conflict if another process took it.

    Its UID would not be enough: taking a Lease over keeps the object.
    """
    meta = lease["metadata"]
    return cluster.delete(ref_of(lease), uid=meta["uid"], version=meta["resourceVersion"])


def keep_renewing(mine: Held, over: threading.Event) -> None:
    """Renew a Lease until it is released or lost; a failed renewal is tried again."""
    while not mine.lost.is_set() and not over.wait(RENEW):
        with suppress(ClusterError):
            mine.renew()
