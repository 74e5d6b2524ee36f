"""How far the clocks of a release's machines differ: `begin` and `finish` read, `judge` decides.

Why: ages of messages and tf compare the times of two machines. The clock of this computer is only
a ruler, held against each of them.

Why an exec of its own in one pod of each machine: the time between question and answer is what
the difference is uncertain by. In the readings that run in pods anyway a Python starts in between,
which takes many times what clocks may differ by; and in ROS 1 they run in a single pod.
"""

from __future__ import annotations

import os
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from io import BytesIO, FileIO
from typing import Any

import attrs

from rigel_inpod.sent import PYTHONS, choose_python, read_module
from rigel_k8s.commands.pods import Pod, pod_of
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.facts import has_ended, is_ending, is_out_of_reach, runs
from rigel_k8s.objects.podnodes import split_all
from rigel_k8s.objects.pods import find_container
from rigel_k8s.problems import Problem

TOLERANCE = 0.01  # seconds that clocks may differ by
TURNS = 8  # answers of a machine, of which the quickest counts
#: Seconds that machines have to answer, from the beginning: so `status` is not slower.
LIMIT = 1.0
REMEDY = "ages of messages and tf between them are wrong by that: run chrony or ntpd on both"
OWN_REMEDY = "only programs of `rigel join` notice: run chrony or ntpd here"
UNITS = ((86400.0, 0, "days"), (3600.0, 0, "h"), (60.0, 0, "min"), (1.0, 1, "s"), (1e-3, 0, "ms"))


@attrs.frozen
class Clock:
    """A machine's clock.

    Attributes:
        ahead: seconds that it is ahead of this computer's.
        doubt: by how many seconds more or less that may be.
    """

    ahead: float
    doubt: float


def judge(clocks: Mapping[str, Clock]) -> list[Problem]:
    """Return the machines whose clocks differ: each once, from a clock that most agree with."""
    problems, named = [], set[str]()
    in_order = sort_by_agreement(clocks)
    for reference in in_order:
        for name in in_order:
            differ = is_different(clocks[reference], clocks[name])
            if differ and not {reference, name} & named:
                named.add(name)
                text = compare(name, clocks[name], reference, clocks[reference])
                problems.append(make_problem(text, REMEDY, name, reference))
    return problems


def judge_own(clocks: Mapping[str, Clock]) -> list[Problem]:
    """Return whether this computer's clock differs from the one that most machines agree with."""
    own = Clock(0.0, 0.0)
    for reference in sort_by_agreement(clocks)[:1]:
        if is_different(own, clocks[reference]):
            text = compare("this computer", own, reference, clocks[reference])
            return [make_problem(text, OWN_REMEDY, reference)]
    return []


def sort_by_agreement(clocks: Mapping[str, Clock]) -> list[str]:
    """Return the machines, first those whose clocks differ from the fewest others."""
    differ = {
        name: sum(is_different(clock, other) for other in clocks.values())
        for name, clock in clocks.items()
    }
    return sorted(clocks, key=lambda name: (differ[name], name))


def is_different(one: Clock, other: Clock) -> bool:
    """Whether two clocks differ by more than they may, whatever their true times are."""
    return abs(one.ahead - other.ahead) > one.doubt + other.doubt + TOLERANCE


def compare(name: str, clock: Clock, other_name: str, other: Clock) -> str:
    """Return by how much a clock is ahead of another one, or behind it."""
    ahead = clock.ahead - other.ahead
    which = "ahead of" if ahead > 0 else "behind"
    doubt = max(1, round((clock.doubt + other.doubt) * 1e3))
    return f"{name} is {describe(abs(ahead))} {which} {other_name} (±{doubt} ms)"


def describe(seconds: float) -> str:
    """Return a time in the unit that fits: 240 ms, 2.4 s, 3 days."""
    size, digits, unit = next((u for u in UNITS if seconds >= 2 * u[0]), UNITS[-1])
    return f"{seconds / size:.{digits}f} {unit}"


def make_problem(text: str, remedy: str, *machines: str) -> Problem:
    """Return a warning: a deploy and the nodes themselves work."""
    message = f"clocks: {text}"
    return Problem((), message, "clocks-differ", "warning", remedy=remedy, subjects=machines)


class Turns:
    """The standard output of clock.py in a pod: sends a question at each answer.

    Args:
        questions: its standard input.
        keep: called with each answer.
    """

    def __init__(self, questions: FileIO, keep: Callable[[Clock], None]) -> None:
        self._questions, self._keep = questions, keep
        # If this computer's clock is set meanwhile, that changes nothing.
        self._base = time.time() - time.monotonic()
        self._left, self._rest = TURNS, b""
        self._ask()

    def _ask(self) -> None:
        self._asked = time.monotonic()
        self._questions.write(b"\n")

    def write(self, data: bytes) -> None:
        """Take output; an answer is a line."""
        now = time.monotonic()
        self._rest += data
        if not self._rest.endswith(b"\n"):
            return
        doubt = (now - self._asked) / 2
        self._keep(Clock(float(self._rest) - self._base - self._asked - doubt, doubt))
        self._left, self._rest = self._left - 1, b""
        if self._left:
            self._ask()
        else:
            self._questions.close()

    def flush(self) -> None:
        """Do nothing: answers are taken at once."""


class Dial:
    """Reads the clock of one machine on a thread of its own, in the first pod that has a Python.

    Attributes:
        clock: the best answer until now; None before the first.
    """

    def __init__(self, cluster: Cluster, pods: Sequence[Pod]) -> None:
        self.clock: Clock | None = None
        self.thread = threading.Thread(target=self._read, args=(cluster, pods), daemon=True)
        self.thread.start()

    def _keep(self, clock: Clock) -> None:
        if self.clock is None or clock.doubt < self.clock.doubt:
            self.clock = clock

    def _read(self, cluster: Cluster, pods: Sequence[Pod]) -> None:
        program = read_module("rigel_inpod.sent.clock")
        command = choose_python(PYTHONS, program, str(TURNS))
        for pod in pods:
            reader, writer = os.pipe()
            with (
                suppress(RigelK8sError, ValueError),  # what is not a number is not an answer
                os.fdopen(reader, "rb") as stdin,
                FileIO(writer, "w") as questions,
            ):
                cluster.exec(
                    pod.namespace,
                    pod.name,
                    command,
                    container=pod.container,
                    stdin=stdin,
                    stdout=Turns(questions, self._keep),  # type: ignore[arg-type]
                    stderr=BytesIO(),
                )
            if self.clock is not None:
                return


@attrs.frozen
class Reading:
    """Clocks that are being read, by machine."""

    begun: float
    dials: Mapping[str, Dial]


def begin(cluster: Cluster, items: Iterable[Mapping[str, Any]]) -> Reading:
    """Begin to read the clocks of all machines that run pods; of a single one, nothing.

    Args:
        items: the pods of a release, as the API server returns them.
    """
    machines = defaultdict[str, list[Pod]](list)
    for pod in list_running(items):
        machines[pod.machine].append(pod)
    if len(machines) < 2:
        machines.clear()
    dials = {name: Dial(cluster, pods) for name, pods in machines.items()}
    return Reading(time.monotonic(), dials)


def list_running(items: Iterable[Mapping[str, Any]]) -> list[Pod]:
    """Return pods in which a program can be run, with the container for it; ready ones first."""
    found = []
    for item in split_all(item for item in items if not is_out_of_reach(dict(item))):
        own = find_container(item["spec"]) or item["spec"]["containers"][0]
        ended = is_ending(item) or has_ended(item)
        if not ended and runs(item.get("status") or {}, own["name"]):
            found.append(attrs.evolve(pod_of(item), container=own["name"]))
    return sorted(found, key=lambda pod: (not pod.ready, pod.key))


def finish(reading: Reading, limit: float = LIMIT) -> dict[str, Clock]:
    """Return the clocks of the machines that have answered `limit` seconds after the beginning."""
    for dial in reading.dials.values():
        dial.thread.join(max(0.0, reading.begun + limit - time.monotonic()))
    return {name: dial.clock for name, dial in reading.dials.items() if dial.clock is not None}
