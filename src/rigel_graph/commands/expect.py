"""expect: compares a running release with what its Rigelfile expects, and proposes that block."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import attrs

from rigel_exporter.expecting import BROKEN, OK, UNKNOWN, Expected
from rigel_graph.expectations import LONGEST, Verdict, choose_span, compare_with
from rigel_graph.reading import read_graph
from rigel_graph.types import SPAN, RosGraph
from rigel_k8s.app.deploying.guests import State
from rigel_k8s.app.expectations import describe_all
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import ClusterError, Interrupted, UserError
from rigel_k8s.release.part import Run
from rigel_k8s.release.revisions import find_last_good
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rigelfile.structure import InvalidOptions, structure_plain
from rigel_k8s.settings import Settings

#: How a test of what is expected ends.
STATES: dict[str, State] = {OK: "passed", BROKEN: "failed", UNKNOWN: "unknown"}
#: How much more than was measured is allowed.
LOWER, HIGHER, LONGER = 0.8, 1.2, 3.0
#: How often at least it is looked while it is learned; a long look is an exact one.
LOOKS = 3
#: Messages per second below which a topic has no rate to rely on.
RARE = 0.5
#: Seconds: what no network promises.
LEAST_AGE = 0.1
#: Seconds after which a publisher's gaps are its own: for 70 the layer remembers those of a start.
SETTLED = 75.0


@attrs.frozen
class Examined:
    """A release beside what is expected of it."""

    release: ReleaseId
    verdicts: tuple[Verdict, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is known to be broken."""
        return not any(one.broken for one in self.verdicts)


def examine(settings: Settings, job: str | None, wait: float = 0.0) -> Examined:
    """Compare a release with what its last good revision expects.

    Args:
        wait: seconds for which it may be broken: it is compared again until then.

    Raises:
        UserError: it expects nothing, or is not on the cluster.
        ClusterError: the graph cannot be read.
    """
    found = release(settings, job)
    with found.cluster:
        expected = read_expected(found)
        if not expected:
            raise UserError(
                f"{found.id.name} was deployed without `expect`",
                hint="`rigel expect learn` proposes it: put it into the Rigelfile, and deploy that",
            )
        return compare(found, expected, wait)


def compare(
    found: Release,
    expected: Mapping[str, Expected],
    wait: float = 0.0,
    cancel: threading.Event | None = None,
) -> Examined:
    """Compare a release with what is expected of it, until `cancel`; otherwise as examine."""
    end = time.monotonic() + wait
    while True:
        graph = read_graph(found.cluster, found.id, span=choose_span(expected))
        seen = Examined(found.id, compare_with(expected, graph))
        if seen.ok or time.monotonic() >= end or (cancel and cancel.is_set()):
            return seen


def test(run: Run, wait: float) -> list[tuple[str, State, str]]:
    """Return what is expected as tests: name, how it ended, why. Raises as read_expected."""
    found, cancel = Release(run.cluster, run.release), run.options.cancel
    expected = read_expected(found)
    if not expected:
        return []
    run.report.line(f"{found.id.name}: comparing its topics with `expect`")
    verdicts = compare(found, expected, wait, cancel).verdicts
    if cancel.is_set():
        raise Interrupted("interrupted while topics were compared with `expect`")
    return [
        (
            f"{one.topic}: {one.finding.what}",
            STATES[one.finding.state],
            one.line if one.broken else "",
        )
        for one in verdicts
    ]


def read_expected(found: Release) -> Mapping[str, Expected]:
    """Return what a release's last good revision expects, by topic.

    Raises:
        UserError: it has no such revision.
    """
    last = find_last_good(found.cluster, found.id)
    if last is None:
        raise UserError(
            f"{found.id.name} has no good revision in the namespace {found.id.namespace}",
            hint="deploy it with `rigel run`, or choose another namespace with -n",
        )
    return parse_expected(last.options)


def parse_expected(options: Mapping[str, Any]) -> Mapping[str, Expected]:
    """Return what the options of a revision expect, by topic."""
    try:
        expected = structure_plain(options, OrchestrationOptions, lambda _: ()).expect
    except InvalidOptions:  # of another version of this program
        expected = {}
    return describe_all(expected)


def name_expected(settings: Settings, job: str | None) -> tuple[str, ...]:
    """Return the topics that a release expects; none if that cannot be read."""
    found = release(settings, job)
    try:
        with found.cluster:
            return tuple(read_expected(found))
    except (ClusterError, UserError):  # the right to read Secrets, which a graph does not need
        return ()


@attrs.define
class Learned:
    """What was measured of a topic: the lowest and the highest of all looks.

    Attributes:
        young: at the last look, the gaps may be those of a start.
    """

    type: str
    publishers: int
    young: bool = False
    lowest: float = math.inf
    highest: float = 0.0
    gap: float = 0.0
    age: float = 0.0

    def propose(self) -> dict[str, Any]:
        """Return what to expect, as the Rigelfile has it."""
        made: dict[str, Any] = {"type": self.type} if self.type else {}
        if RARE <= self.lowest < math.inf:
            made["rate"] = f"{round_down(self.lowest * LOWER)}..{round_up(self.highest * HIGHER)}"
            if self.gap:
                made["gap"] = f"{round_up(self.gap * LONGER)}s"
        if self.age:
            made["age"] = f"{round_up(max(self.age * LONGER, LEAST_AGE))}s"
        return {**made, "publishers": self.publishers}


def learn(
    settings: Settings, job: str | None, seconds: float, report: Callable[[str], None]
) -> dict[str, Learned]:
    """Return what each public topic that is published does, from looks for so long.

    Raises: as examine.
    """
    found = release(settings, job)
    learned: dict[str, Learned] = {}
    span = max(SPAN, min(seconds / LOOKS, LONGEST))
    with found.cluster:
        end, looks = time.monotonic() + seconds, 0
        while True:
            note(learned, read_graph(found.cluster, found.id, span=span))
            looks += 1
            report(f"{len(learned)} topics, {looks} looks")
            if time.monotonic() >= end:
                break
    return dict(sorted(learned.items()))


def note(learned: dict[str, Learned], graph: RosGraph) -> None:
    """Take in one look."""
    own = {node.name for node in graph.nodes if node.pod}
    for topic in graph.topics:
        if not topic.is_public or not own.intersection(topic.publishers):
            continue
        one = learned.setdefault(topic.name, Learned(topic.type, len(topic.publishers)))
        one.type, one.publishers = topic.type, len(topic.publishers)
        if topic.rate is not None:
            one.lowest = min(one.lowest, topic.rate)
            one.highest = max(one.highest, topic.rate)
        one.young = topic.exists is not None and topic.exists < SETTLED
        if not one.young:
            one.gap = max(one.gap, topic.gap or 0.0)
        one.age = max(one.age, topic.age or 0.0)


def round_down(value: float) -> str:
    """Return a number with two digits that is not larger."""
    return round_to(value, math.floor)


def round_up(value: float) -> str:
    """Return a number with two digits that is not smaller."""
    return round_to(value, math.ceil)


def round_to(value: float, way: Callable[[float], int]) -> str:
    """Return a positive number with two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{round(way(round(value / step, 6)) * step, 6):g}"
