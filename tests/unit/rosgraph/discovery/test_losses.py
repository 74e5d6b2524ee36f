"""A topic that loses messages between its ends is named, and nothing else is."""

from __future__ import annotations

import re
from typing import Any

import attrs
import pytest

from rigel_graph.discovery.findings import graph
from rigel_graph.discovery.looks import of_notes
from rigel_graph.discovery.losses import Loss, find_losses, measure_flows
from rigel_graph.problems import find_problems
from rigel_graph.types import GraphTopic, RosGraph
from tests.support.members import member
from tests.support.notes import NOW, SECOND, answer, entity, process, publisher, subscription

IMAGE, SPAN = "/camera/image", 2
TEXT = "/camera/image: 30.0/s sent by camera, 0.5/s taken by detector"


def losses(
    sent: int = 60, taken: int = 1, *, camera: Any = None, detector: Any = None, **more: Any
) -> list[Loss]:
    """What two readings of a camera's and a detector's pods show; both ran before.

    Args:
        camera, detector: fields of the publisher and of the subscription.
        more: fields of the detector's process, `first` and `second`, or of both.
    """
    one = {"matched": 1, "longest": SECOND // 20, **(camera or {})}
    other = {"matched": 1, **(detector or {})}
    sides = more.pop("first", {}), more.pop("second", {})
    parts = more.pop("parts", [])
    pods: list[tuple[Any, Any]] = [(), ()]
    for number, (now, count) in enumerate(((NOW - SPAN * SECOND, 0), (NOW, 1))):
        ends = [
            (process("/camera", parts=[publisher("/camera", IMAGE, 100 + count * sent, **one)])),
            process(
                "/detector",
                parts=[subscription("/detector", IMAGE, 90 + count * taken, **other), *parts],
                **{**more, **sides[number]},
            ),
        ]
        for at, its in enumerate(ends):
            pods[at] = (*pods[at], answer(its, now=now))
    return list(find_losses(flow for pod in pods for flow in measure_flows(*pod)))


def test_a_topic_that_loses_messages_is_named() -> None:
    (loss,) = losses()
    assert loss.problem.message == TEXT
    assert (loss.problem.severity, loss.problem.subjects) == ("warning", ("/detector",))
    assert {"`pod: NAME`", "`shared_memory: true`"} <= set(
        re.findall("`[^`]+`", loss.problem.remedy or "")
    )


@pytest.mark.parametrize(
    ("why", "fields"),
    [
        ("all arrive", {"taken": 58}),
        ("one that is replaced takes no more", {"second": {"mode": 4}}),
        ("one that works since a moment", {"first": {"mode": 1}}),
        ("it waited, and did not handle what it took", {"detector": {"dropped": 0}, "mode": 1}),
        ("it has just been made", {"detector": {"created": NOW - 4 * SECOND}}),
        ("it has just been matched", {"detector": {"matched": 0}}),
        ("it never matches: another problem names that", {"detector": {"matched": 0}}),
        ("it has another type", {"detector": {"type": "std_msgs/msg/Int8"}}),
        ("its callbacks are too slow for its queue", {"stands": SECOND}),
        ("they were at one of both readings", {"first": {"stands": SECOND // 10}}),
        ("it is sent seldom", {"sent": 8, "taken": 0}),
        ("it is sent in bursts", {"camera": {"longest": 3 * SECOND}}),
        ("it is not sent any more", {"camera": {"last": NOW - 3 * SECOND}}),
        ("its publisher has found no one", {"camera": {"matched": 0}}),
        ("its publisher has just been made", {"camera": {"created": NOW - 4 * SECOND}}),
    ],
)
def test_what_is_no_loss_is_not_named(why: str, fields: dict[str, Any]) -> None:
    assert losses(**fields) == [], why


def test_a_process_that_was_restarted_is_not_compared() -> None:
    """Its counts began again."""
    assert losses(first={"pid": 7}, second={"pid": 8}) == []


def test_a_program_without_executor_may_take_what_it_likes() -> None:
    """It asks its subscription when it wants a message."""
    first = answer(process("/camera", parts=[publisher("/camera", IMAGE, matched=1)]), now=NOW - 1)
    flows = measure_flows(first, first)
    assert flows == ()
    bare = process("/detector", parts=[subscription("/detector", IMAGE, 1, matched=1)])
    bare["entities"] = [one for one in bare["entities"] if one["kind"] != "executor"]
    before, after = answer(bare, now=NOW - SECOND), answer(bare)
    (flow,) = measure_flows(before, after)
    assert not flow.idle


def test_several_publishers_are_added_up() -> None:
    """A subscriber that has found only some of them gets only theirs."""
    first, second = (
        answer(
            process("/a", parts=[publisher("/a", IMAGE, count, matched=1)]),
            process("/b", parts=[publisher("/b", IMAGE, count, matched=1)], pid=8),
            process("/c", parts=[subscription("/c", IMAGE, count, matched=partners)], pid=9),
            now=now,
        )
        for count, now, partners in ((0, NOW - SECOND, 2), (20, NOW, 2))
    )
    (loss,) = find_losses(measure_flows(first, second))
    assert (loss.senders, loss.sent, loss.taken) == (("/a", "/b"), 40.0, 20.0)
    flows = [attrs.evolve(one, partners=1) for one in measure_flows(first, second)]
    assert list(find_losses(flows)) == []


def test_status_and_graph_name_it() -> None:
    """Both from the same function."""
    pods = {}
    for name, kind, count in (("camera", publisher, 30), ("detector", subscription, 0)):
        first, second = (
            answer(process(f"/{name}", parts=[kind(f"/{name}", IMAGE, n, matched=1)]), now=now)
            for n, now in ((0, NOW - SECOND), (count, NOW))
        )
        flows = measure_flows(first, second)
        pods[name] = attrs.evolve(of_notes(second), flows=flows)
    members = [member(name, has_layer=True) for name in pods]
    found = [one.message for one in graph(members, pods).problems if one.kind == "lossy"]
    assert found == [TEXT.replace("0.5/s", "0.0/s")]
    (loss,) = losses()
    topic = GraphTopic(IMAGE, "T", ("/camera",), ("/detector",), losses=(loss.problem,))
    assert [one.message for one in find_problems(RosGraph(topics=(topic,)))] == [TEXT]


def test_a_stuck_executor_is_not_a_loss() -> None:
    busy = entity("executor", "", last=NOW - 41 * SECOND)
    assert losses(parts=[busy], stands=41 * SECOND) == []
