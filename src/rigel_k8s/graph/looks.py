"""Looks into pods: runs inpod/dds.py in all of them at the same time, and reads what it tells.

All have to overlap, since one hears another only while that one sends: each tells when it hears,
and is told when it is enough.
"""

from __future__ import annotations

import io
import json
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.graph.members import Member
from rigel_k8s.inpod import MOUNT_PATH
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.network.modes.peers import peer_name

START = 15.0  # seconds until the last one has to hear: a Python start on a busy machine, and DNS
LISTEN = 1.5  # seconds for which all hear each other, where nobody says it
END = 10.0  # seconds until the last one has to have told
TICK = 0.05  # seconds between two looks at the others
LONGEST = 32  # seconds after which a script ends where nobody tells it anything
ANNOUNCERS = 24  # more stand-ins would make every participant answer more than these show
ROUTER = 7447  # zenoh's port
SLOW = "its container did not answer in time; is its machine busy, or away?"
#: How an API server reports that it has no connection to a kubelet.
UNREACHED = re.compile(r"dial tcp [^ ]+: (?:connect: )?(.+)$")
SCRIPT = ("python3", "-S", "-E", "-B", f"{MOUNT_PATH}/dds.py")


@attrs.frozen
class Observation:
    """What was seen in one pod.

    Attributes:
        problem: why nothing could be seen, "" where it could.
        interfaces: name -> IPv4 address, None for an interface without one.
        down: those interfaces that are down.
        own: the pod's processes that take part: pid, command, domain, stopped, ports.
        heard: the participants that a stand-in in this pod discovered; `own` for the pod's.
        beacons: the pods whose beacons came here.
        servers: discovery server -> whether it answered.
        routers: the addresses of zenoh routers that it is connected to.
        announced: whether a stand-in announced itself here, so that `heard` is complete.
        sends: whether it sends beacons, for its machine.
    """

    problem: str = ""
    interfaces: Mapping[str, str | None] = attrs.field(factory=dict)
    down: frozenset[str] = frozenset()
    own: Sequence[Mapping[str, Any]] = ()
    heard: Sequence[Mapping[str, Any]] = ()
    beacons: frozenset[str] = frozenset()
    servers: Mapping[str, bool] = attrs.field(factory=dict)
    routers: Sequence[str] = ()
    announced: bool = False
    sends: bool = False

    def is_on_network(self, member: Member) -> bool:
        """Whether the pod has the network that it is to have."""
        name = member.interface
        return not name or bool(self.interfaces.get(name) and name not in self.down)


def commands(found: Sequence[Member]) -> dict[str, list[str]]:
    """Return pod -> what is run in it.

    One pod of each machine sends beacons: that is enough to tell which machines hear each other.
    """
    senders = {member.machine: member.pod for member in reversed(found) if member.by_multicast}
    order = sorted(found, key=lambda m: m.pod not in senders.values())
    announcers = {m.pod for m in [m for m in order if m.by_multicast][:ANNOUNCERS]}
    return {m.pod: command(m, found, senders, announcers) for m in found}


def command(
    member: Member,
    found: Iterable[Member],
    senders: Mapping[str, str],
    announcers: Iterable[str],
) -> list[str]:
    """Return what is run in one pod."""
    words = [*SCRIPT, "--seconds", str(LONGEST)]
    if member.domain is not None:
        words += ["--domain", str(member.domain)]
    if member.interface:
        words += ["--interface", member.interface]
    if member.pod in announcers:
        words += ["--announce"]
    if member.pod in senders.values():
        words += ["--beacon", member.pod]
    if member.mode == "peers":
        others = {peer_name(m.workload) for m in found if m.workload != member.workload}
        words += [word for name in sorted(others) for word in ("--ask", name)]
    for server in member.servers:
        words += ["--server", server]
    if member.middleware == "zenoh":
        words += ["--router", str(ROUTER)]
    return words


def look(
    cluster: Cluster,
    found: Sequence[Member],
    cancel: threading.Event | None = None,
    *,
    seconds: float = LISTEN,
) -> dict[str, Observation]:
    """Return pod -> what was seen in it.

    Args:
        seconds: for how long all hear each other.

    Raises:
        Interrupted: `cancel` was set.
    """
    running = [member for member in found if member.running and member.reachable]
    words = commands(running)
    runs = [Look(cluster, member, words[member.pod]) for member in running]
    wait(runs, lambda run: run.hears, START, cancel)
    for run in runs:
        run.late = not run.hears
    wait(runs, lambda run: run.ended, seconds, cancel)
    for run in runs:
        run.finish()
    wait(runs, lambda run: run.ended, END, cancel)
    seen = {run.member.pod: run.read_observation() for run in runs}
    return {m.pod: seen.get(m.pod) or Observation(why_unseen(m)) for m in found}


def why_unseen(member: Member) -> str:
    """Return why nothing was run in a pod."""
    if not member.reachable:
        return f"Kubernetes cannot reach the machine {member.machine}"
    return "its container does not run"


def wait(
    runs: Sequence[Look],
    done: Callable[[Look], bool],
    seconds: float,
    cancel: threading.Event | None,
) -> None:
    """Wait until something holds for all, at most so long."""
    until = time.monotonic() + seconds
    while not all(done(run) for run in runs) and time.monotonic() < until:
        if cancel is not None and cancel.wait(TICK):
            for run in runs:
                run.finish()
            raise Interrupted("stopped while looking at the DDS graph; the release stays deployed")
        if cancel is None:
            time.sleep(TICK)


class Look:
    """The script in one pod, on a thread of its own."""

    def __init__(self, cluster: Cluster, member: Member, words: Sequence[str]):
        self.cluster, self.member, self.words = cluster, member, words
        self.output, self.errors = io.BytesIO(), io.BytesIO()
        self.code: int | None = None
        self.problem = ""
        self.late = False  # whether the others were heard without it
        reading, self.writing = os.pipe()
        self.stdin = os.fdopen(reading, "rb", buffering=0)
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self) -> None:
        """Run it until its end."""
        try:
            self.code = self.cluster.exec(
                self.member.namespace,
                self.member.pod,
                self.words,
                container=self.member.container,
                stdin=self.stdin,
                stdout=self.output,
                stderr=self.errors,
            )
        except ClusterError as error:
            self.problem = reason(error)
        finally:
            self.stdin.close()

    @property
    def ended(self) -> bool:
        """Whether it has told everything, or will tell nothing."""
        return not self.thread.is_alive()

    @property
    def hears(self) -> bool:
        """Whether it has told that it hears, or never will."""
        return self.ended or b"\n" in self.output.getvalue()

    def finish(self) -> None:
        """Tell it to end; once."""
        if self.writing >= 0:
            with suppress(BrokenPipeError):  # it has ended by itself
                os.write(self.writing, b"\n")
            os.close(self.writing)
            self.writing = -1

    def read_observation(self) -> Observation:
        """Return what it told."""
        lines = self.output.getvalue().decode("utf-8", "replace").splitlines()
        if self.late and not self.problem:
            return Observation(SLOW)
        if self.problem or len(lines) != 2 or self.code != 0:
            return Observation(self.problem or self.failure(lines))
        here, heard = json.loads(lines[0]), json.loads(lines[1])
        return Observation(
            interfaces=here["interfaces"],
            down=frozenset(here["down"]),
            own=here["participants"],
            heard=heard["participants"],
            beacons=frozenset(heard["beacons"]),
            servers=heard["servers"],
            routers=here["routers"],
            announced="--announce" in self.words,
            sends="--beacon" in self.words,
        )

    def failure(self, lines: Sequence[str]) -> str:
        """Return why there is no answer."""
        if self.code is None:
            return SLOW
        told = self.errors.getvalue().decode("utf-8", "replace").splitlines() or list(lines)
        if any("can't open file" in line for line in told):
            return "it was deployed by an older version, without this check: deploy it again"
        return f"the check failed in it: {told[-1]}" if told else "the check told nothing"


def reason(error: ClusterError) -> str:
    """Return why a command could not be run, in few words."""
    if isinstance(error, Forbidden):
        return "looking into pods is not allowed here (the right `create pods/exec`)"
    if "executable file not found" in error.message or "no such file" in error.message:
        return "its image has no python3, so nothing can look from inside it"
    if unreached := UNREACHED.search(error.message):
        return f"the API server cannot reach its machine ({unreached[1]})"
    return error.message
