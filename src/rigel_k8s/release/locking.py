"""One deploy of a release at a time: take its Lease, renew it, wait for another holder's end.

A process that waits for a Lease takes it if it was not renewed for DURATION. So a holder writes
only within that time after a renewal, and renews it first if the time is over: another deploy may
have begun while an API server was unreachable or a machine slept.
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
from rigel_k8s.objects.facts import is_ending
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.types import DeployOptions, ReleaseId
from rigel_k8s.report import Reporter

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
        if now is not None:
            self.successor = describe(self.ref, now)
        elif self.lacks_namespace():
            self.successor = f"the namespace {self.ref.namespace} is being deleted"
        else:
            self.successor = f"another process has removed {self.ref}"
        self.lost.set()

    def lacks_namespace(self) -> bool:
        """Whether the Lease's namespace has been deleted, or is being so."""
        try:
            space = self.cluster.get(ObjectRef("v1", "Namespace", "", self.ref.namespace))
        except ClusterError:  # we may not see it
            return False
        return space is None or is_ending(space)


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
