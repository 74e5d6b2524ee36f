"""What a Rigelfile expects of topics, beside graphs."""

from __future__ import annotations

from contextlib import nullcontext
from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_exporter.expecting import BROKEN, OK, UNKNOWN, Expected, Reading, describe, judge
from rigel_graph import watching
from rigel_graph.commands import expect as expecting
from rigel_graph.commands.expect import Learned, note, round_down, round_up
from rigel_graph.expectations import LONGEST, choose_span, compare_with, list_broken
from rigel_graph.types import SPAN, GraphNode, GraphTopic, RosGraph
from rigel_graph.watching import GraphWatch, GraphWorse
from rigel_k8s.app.expectations import Expectation, describe_all
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.scalars import Duration, Range, RosName
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rigelfile.structure import InvalidOptions, structure_plain
from rigel_k8s.settings import Settings
from tests.support.recorder import Recorder

SCAN = RosName("/scan")
INFINITE = float("inf")


def read(**options: Any) -> Expectation:
    """Return an expectation as a Rigelfile has it."""
    given = {"expect": {"/scan": options}}
    return structure_plain(given, OrchestrationOptions, lambda _: ()).expect[SCAN]


def graph(*publishers: str, subscribers: tuple[str, ...] = (), **topic: Any) -> RosGraph:
    """Return a graph of one topic."""
    nodes = tuple(GraphNode(name, pod=f"{name}-1", workload=name) for name in ("/lidar", "/map"))
    return RosGraph(nodes, (GraphTopic("/scan", "a/msg/B", publishers, subscribers, **topic),))


def states(expectation: Expectation, found: RosGraph) -> dict[str, str]:
    """Return the state of each thing that is expected of the topic."""
    verdicts = compare_with(describe_all({SCAN: expectation}), found)
    return {one.finding.what: one.finding.state for one in verdicts}


@pytest.mark.parametrize(
    ("what", "expected", "good", "bad"),
    [
        ("type", "a/msg/B", "a/B", "a/msg/C"),
        ("rate", (8.0, 12.0), 8.0, 7.9),
        ("rate", (8.0, 12.0), 12.0, 12.1),
        ("rate", (8.0, INFINITE), 1000.0, 7.9),
        ("gap", 0.5, 0.5, 0.51),
        ("age", 0.2, 0.0, 0.21),
        ("publishers", (1.0, 1.0), 1, 2),
        ("subscribers", (1.0, INFINITE), 7, 0),
    ],
)
def test_each_thing_has_its_limits(what: str, expected: Any, good: Any, bad: Any) -> None:
    """What is at a limit is good; what was not measured is unknown, never broken."""
    wanted = Expected(**{what: expected})
    found = [list(judge(wanted, Reading(**{what: value}))) for value in (good, bad, None)]
    assert [one.state for (one,) in found] == [OK, BROKEN, UNKNOWN]


@pytest.mark.parametrize(
    ("rate", "span", "state"),
    [(1.5, 2.0, OK), (3.0, 2.0, OK), (1.0, 2.0, BROKEN), (3.0, 10.0, BROKEN), (3.0, 0.0, BROKEN)],
)
def test_one_message_more_or_less_breaks_no_rate(rate: float, span: float, state: str) -> None:
    """Of a topic of 2/s some two seconds have three, or six; what is exact has no such margin."""
    wanted, reading = Expected(rate=(1.6, 2.5)), Reading(rate=rate, publishers=1)
    assert [one.state for one in judge(wanted, reading, span)] == [state]


def test_a_topic_without_a_publisher_has_no_margin() -> None:
    """It is silent for sure."""
    wanted, reading = Expected(rate=(0.1, 9.0)), Reading(rate=0.0, publishers=0)
    assert [one.state for one in judge(wanted, reading, 2.0)] == [BROKEN]


@pytest.mark.parametrize(
    ("rates", "seconds"), [((), SPAN), ((20.0,), SPAN), ((20.0, 2.0), 5.0), ((0.1,), LONGEST)]
)
def test_slow_topics_are_measured_for_longer(rates: tuple[float, ...], seconds: float) -> None:
    wanted = {f"/{rate}": Expected(rate=(rate, INFINITE)) for rate in rates}
    assert choose_span({**wanted, "/any": Expected(publishers=(1, 1))}) == seconds


def test_nothing_is_judged_that_is_not_expected() -> None:
    assert list(judge(Expected(), Reading(type="a/B", rate=1.0))) == []


def test_without_a_publisher_nothing_can_be_right() -> None:
    """A topic that is not in the graph, or is only subscribed to: gap and age are broken, too."""
    wanted = read(type="a/B", rate=10, gap="500ms", age="1s", publishers=1)
    assert set(states(wanted, RosGraph()).values()) == {BROKEN}
    silent = graph(subscribers=("/map",), rate=0.0)
    assert states(wanted, silent) == {**dict.fromkeys(states(wanted, silent), BROKEN), "type": OK}


def test_a_graph_without_rates_breaks_nothing() -> None:
    """As that of nodes without the layer."""
    wanted = read(rate="8..12", gap="500ms", age="1s", publishers=1)
    unknown = {"rate": UNKNOWN, "gap": UNKNOWN, "age": UNKNOWN}
    assert states(wanted, graph("/lidar")) == {**unknown, "publishers": OK}


@pytest.mark.parametrize(
    ("text", "limits"),
    [
        ("2", (2.0, 2.0)),
        ("8..12", (8.0, 12.0)),
        ("0.5..", (0.5, INFINITE)),
        ("..12", (0.0, 12.0)),
    ],
)
def test_ranges(text: str, limits: tuple[float, float]) -> None:
    assert Range.parse(text).limits == limits


def test_milliseconds() -> None:
    """Minutes stay minutes."""
    assert Duration.parse("500ms").seconds == 0.5
    assert Duration.parse("5m").seconds == 300.0
    assert Duration.parse("1m30s").seconds == 90.0


def test_a_single_rate_is_about_that() -> None:
    """No clock keeps 10 Hz exactly."""
    assert read(rate=10).describe().rate == (8.0, 12.0)
    assert read(publishers=1).describe().publishers == (1.0, 1.0)


def test_a_mistake_names_its_place() -> None:
    with pytest.raises(InvalidOptions, match="range such as") as error:
        read(rate="fast")
    assert error.value.problems[0].path == ("expect", "/scan", "rate")


def update(expectation: Expectation, before: RosGraph, after: RosGraph) -> list[str]:
    """Watch an update between two looks; return the warnings.

    Raises:
        GraphWorse: it is refused.
    """
    report, expected = Recorder(), describe_all({SCAN: expectation})
    cluster: Any = None
    watch = GraphWatch(cluster, ReleaseId("n", "lab"), report, Event(), 0.0, expected)
    watch._before = before
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watching, "list_pods", lambda *_: [])
        patch.setattr(watching, "read_graph", lambda *_: after)
        watch.report()
    return report.warnings


def test_an_update_that_breaks_an_expectation_is_worse() -> None:
    """Only what was not broken before counts; without `else: rollback` it is not refused."""
    before, after = graph("/lidar", rate=10.0), graph("/lidar", rate=7.0)
    line = "/scan: rate 7/s, expected 8..12/s"
    assert update(read(rate="8..12"), before, after) == [line]
    strict = read(rate="8..12", **{"else": "rollback"})
    with pytest.raises(GraphWorse) as refused:
        update(strict, before, after)
    assert refused.value.details == (line,)
    assert update(strict, after, after) == []


def test_one_cause_is_one_line() -> None:
    """A topic that has lost its publisher has no rate and no gap, which needs no words."""
    strict = read(rate="8..12", gap="1s", publishers=1, **{"else": "rollback"})
    with pytest.raises(GraphWorse) as refused:
        update(strict, graph("/lidar", rate=10.0, gap=0.1), graph())
    assert refused.value.details == ("/scan had 1 publisher, now 0",)


def test_what_was_broken_before_is_known() -> None:
    wanted = describe_all({SCAN: read(rate="8..12", publishers=2)})
    verdicts = compare_with(wanted, graph("/lidar", rate=1.0))
    assert [one.finding.what for one in list_broken(verdicts[:1], verdicts)] == ["publishers"]


def test_values_are_for_people() -> None:
    assert describe("rate", (8.0, 12.0)) == "8..12/s"
    assert describe("rate", (8.0, INFINITE)) == "8/s or more"
    assert describe("publishers", (1.0, 1.0)) == "1"
    assert describe("gap", 0.25) == "250 ms"
    assert describe("gap", 1.5) == "1.5 s"


def test_what_is_learned_holds_for_what_was_seen() -> None:
    """With margins; the type, and how many publish; nothing of topics that others publish."""
    learned: dict[str, Learned] = {}
    looks = [
        graph("/lidar", rate=9.6, gap=0.11, age=0.002, exists=80.0),
        graph("/lidar", rate=10.3, gap=0.14, age=0.001, exists=90.0),
    ]
    other = GraphTopic("/plan", "a/msg/B", ("/rviz",), rate=1.0)
    for look in looks:
        note(learned, RosGraph(look.nodes, (*look.topics, other)))
    assert list(learned) == ["/scan"]
    proposed = learned["/scan"].propose()
    assert proposed == {
        "type": "a/msg/B",
        "rate": "7.6..13",
        "gap": "0.42s",
        "age": "0.1s",
        "publishers": 1,
    }
    for look in looks:
        assert set(states(read(**proposed), look).values()) == {OK}


def test_the_gap_of_a_start_is_not_learned() -> None:
    """It is remembered for a minute; one without a later look has no gap."""
    learned: dict[str, Learned] = {}
    note(learned, graph("/lidar", rate=10.0, gap=3.0, exists=20.0))
    assert ("gap" in learned["/scan"].propose(), learned["/scan"].young) == (False, True)
    note(learned, graph("/lidar", rate=10.0, gap=0.1, exists=80.0))
    assert (learned["/scan"].propose()["gap"], learned["/scan"].young) == ("0.3s", False)


def test_a_rare_topic_has_no_rate() -> None:
    """A map that is published once is not a topic that has failed."""
    learned: dict[str, Learned] = {}
    note(learned, graph("/map", rate=0.0, gap=50.0, age=1.0))
    assert set(learned["/scan"].propose()) == {"type", "age", "publishers"}


@pytest.mark.parametrize(
    ("value", "low", "high"), [(7.68, "7.6", "7.7"), (123.4, "120", "130"), (10.0, "10", "10")]
)
def test_numbers_have_two_digits(value: float, low: str, high: str) -> None:
    assert (round_down(value), round_up(value)) == (low, high)


def test_a_release_without_it_leads_to_learning_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is not deployed is another matter."""
    cluster: Any = nullcontext()
    found = Release(cluster, ReleaseId("robots", "lab"))
    monkeypatch.setattr(expecting, "release", lambda *_: found)
    monkeypatch.setattr(expecting, "find_last_good", lambda *_: None)
    with pytest.raises(UserError, match="lab has no good revision in the namespace robots"):
        expecting.examine(Settings(), None)
    revision = SimpleNamespace(options={"nodes": {"a": {"image": "a"}}})
    monkeypatch.setattr(expecting, "find_last_good", lambda *_: revision)
    with pytest.raises(UserError) as error:
        expecting.examine(Settings(), None)
    assert "rigel expect learn" in str(error.value.hint)


@pytest.mark.parametrize(("wait", "ok", "looks"), [(0.0, False, 1), (60.0, True, 3)])
def test_nodes_are_given_time(
    monkeypatch: pytest.MonkeyPatch, *, wait: float, ok: bool, looks: int
) -> None:
    """In CI: until nothing is broken, not a moment longer."""
    rates = iter([0.5, 1.0, 10.0, 10.0])
    seen: list[RosGraph] = []

    def look(*_: Any, **__: Any) -> RosGraph:
        seen.append(graph("/lidar", rate=next(rates)))
        return seen[-1]

    found = Release(nullcontext(), ReleaseId("robots", "lab"))  # type: ignore[arg-type]
    monkeypatch.setattr(expecting, "release", lambda *_: found)
    monkeypatch.setattr(expecting, "read_graph", look)
    monkeypatch.setattr(
        expecting, "read_expected", lambda _: describe_all({SCAN: read(rate="8..12")})
    )
    assert expecting.examine(Settings(), None, wait).ok is ok
    assert len(seen) == looks


@pytest.mark.parametrize(
    ("answer", "names"),
    [
        (describe_all({SCAN: read(rate="8..12")}), ("/scan",)),
        (ClusterError("secrets is forbidden"), ()),
        (UserError("it has no good revision"), ()),
    ],
)
def test_a_layout_needs_no_expectations(
    monkeypatch: pytest.MonkeyPatch, answer: Any, names: tuple[str, ...]
) -> None:
    """Who may read a graph may not be allowed to read revisions, which are Secrets."""

    def look(_: Release) -> Any:
        if isinstance(answer, Exception):
            raise answer
        return answer

    found = Release(nullcontext(), ReleaseId("robots", "lab"))  # type: ignore[arg-type]
    monkeypatch.setattr(expecting, "release", lambda *_: found)
    monkeypatch.setattr(expecting, "read_expected", look)
    assert expecting.name_expected(Settings(), None) == names
