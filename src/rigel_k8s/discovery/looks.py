"""Looks into pods: runs rigel_inpod/dds.py in all of them at the same time, and reads its output.

The runs have to overlap, since a script receives from another only while that one sends: each
reports when it receives, and ends when it gets a line.
"""

from __future__ import annotations

import io
import json
import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any

import attrs

from rigel_inpod.sent import LOADER, pack, read_module
from rigel_k8s.discovery.members import Member
from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import explain_exec
from rigel_k8s.network.modes.peers import peer_name

START = 15.0  # seconds until all must receive: a Python start on a busy machine, and DNS
LISTEN = 1.5  # seconds for which all receive from each other, by default
END = 10.0  # seconds until all must have printed their results
TICK = 0.05  # seconds between two looks at the runs
LONGEST = 32  # seconds after which a script ends without a line
ANNOUNCERS = 24  # more stand-ins would show nothing new, but every participant answers each
ROUTER = 7447  # zenoh's port
SLOW = "its container did not answer in time; its machine may be busy or unreachable"
SCRIPT = ("python3", "-S", "-E", "-B", "-c", LOADER)
#: What is sent, each after those that it imports.
MODULES = ("container", "rtps", "interfaces", "spdp", "dds_local", "dds_standin", "dds")


@attrs.frozen
class Observation:
    """What was seen in one pod.

    Attributes:
        problem: why the pod could not be examined, "" if it could.
        interfaces: name -> IPv4 address, None for an interface without one.
        down: those interfaces that are down.
        own: the pod's processes that take part: pid, command, domain, stopped, ports.
        heard: the participants that a stand-in in this pod discovered; `own` marks the pod's.
        beacons: the pods whose beacons arrived here.
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
        """Whether the pod has its interface and address."""
        name = member.interface
        return not name or bool(self.interfaces.get(name) and name not in self.down)


def commands(found: Sequence[Member]) -> dict[str, list[str]]:
    """Return pod -> the command to run in it.

    One pod of each machine sends beacons: that shows which machines receive from which.
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
    """Return the command to run in one pod."""
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
        seconds: for how long all receive from each other.

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


@cache
def sent() -> bytes:
    """Return the script with its modules, as its loader reads them."""
    return pack([(name, read_module(f"rigel_inpod.{name}")) for name in MODULES])


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
    """Wait until something holds for all runs, at most so many seconds."""
    until = time.monotonic() + seconds
    while not all(done(run) for run in runs) and time.monotonic() < until:
        if cancel is not None and cancel.wait(TICK):
            for run in runs:
                run.finish()
            raise Interrupted(
                "interrupted while checking the DDS graph; the release stays deployed"
            )
        if cancel is None:
            time.sleep(TICK)


class Look:
    """The script in one pod, on a thread of its own."""

    def __init__(self, cluster: Cluster, member: Member, words: Sequence[str]):
        self.cluster, self.member, self.words = cluster, member, words
        self.output, self.errors = io.BytesIO(), io.BytesIO()
        self.code: int | None = None
        self.problem = ""
        self.late = False  # whether the others began without it
        reading, self.writing = os.pipe()
        self.stdin = os.fdopen(reading, "rb", buffering=0)
        os.write(self.writing, sent())  # less than a pipe holds
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self) -> None:
        """Run the script until its end."""
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
            self.problem = explain_exec(error)
        finally:
            self.stdin.close()

    @property
    def ended(self) -> bool:
        """Whether it has ended, with or without a result."""
        return not self.thread.is_alive()

    @property
    def hears(self) -> bool:
        """Whether it has reported that it receives, or has ended."""
        return self.ended or b"\n" in self.output.getvalue()

    def finish(self) -> None:
        """Make it end; only the first call has an effect."""
        if self.writing >= 0:
            with suppress(BrokenPipeError):  # it has already ended
                os.write(self.writing, b"\n")
            os.close(self.writing)
            self.writing = -1

    def read_observation(self) -> Observation:
        """Return what it saw."""
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
        """Return why there is no result."""
        if self.code is None:
            return SLOW
        printed = self.errors.getvalue().decode("utf-8", "replace").splitlines() or list(lines)
        return f"the check failed in it: {printed[-1]}" if printed else "the check printed nothing"
