"""When an update may begin: once no action has a goal in progress, and topics are silent."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_graph import idle
from rigel_graph.discovery.inside import Unread
from rigel_graph.idle import list_busy, wait_until_idle
from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.release.types import ReleaseId
from tests.support.notes import SECOND, answer, process, publisher, subscription
from tests.support.recorder import Recorder

RELEASE = ReleaseId("robots", "lab")
PODS = [SimpleNamespace(key=str(n), has_layer=True, running=True) for n in range(4)]


class Cluster:
    """Its pods answer with the goals of one process each."""

    def __init__(self, *goals: list[str] | None) -> None:
        self.goals = goals

    def parallel(self, function: Any, items: Any) -> list[Any]:
        made = [process(goals=goals) for goals in self.goals]
        for one in made:
            if one["goals"] is None:
                del one["goals"]
        return [Unread("lidar-1", "it has no Python"), *({"first": answer(one)} for one in made)]


@pytest.fixture(autouse=True)
def pods(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(idle, "list_pods", lambda *_: [])
    monkeypatch.setattr(idle, "read_pods", lambda _: PODS)
    monkeypatch.setattr(idle, "AGAIN", 0.01)


def test_actions_are_named_once() -> None:
    """A pod of an older version, or that cannot be read, has none."""
    cluster: Any = Cluster(["/b", "/a"], ["/a"], None)
    busy = list_busy(cluster, RELEASE, {})
    assert busy == ["/a has a goal in progress", "/b has a goal in progress"]


def test_a_topic_is_busy_until_it_has_been_silent_for_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Publishers count, not who hears; one that has not published yet is silent."""
    published = (("/cmd_vel", 8), ("/cmd_vel", 2), ("/arm", 4), ("/never", 0), ("/other", 9))
    parts = [publisher("/teleop", topic, last=second * SECOND) for topic, second in published]
    parts.append(subscription("/teleop", "/heard", last=9 * SECOND))
    answers = {"pod": {"first": answer(process("/teleop", parts=parts), now=10 * SECOND)}}
    monkeypatch.setattr(idle, "ask_all", lambda *_: (answers, []))
    silent = dict.fromkeys(("/cmd_vel", "/arm", "/never", "/heard"), 3.0)
    assert list_busy(Cluster(), RELEASE, silent) == ["/cmd_vel is published"]  # type: ignore[arg-type]


def waits(looks: Iterator[list[str]], monkeypatch: pytest.MonkeyPatch, **words: Any) -> Recorder:
    """Wait with these looks, and return what was reported."""
    report, cluster = Recorder(), Cluster()
    monkeypatch.setattr(idle, "list_busy", lambda *_: next(looks))
    cancel = words.get("cancel", Event())
    seconds = words.get("seconds", 60.0)
    wait_until_idle(cluster, RELEASE, report, cancel, seconds, {})  # type: ignore[arg-type]
    return report


def test_an_idle_robot_needs_no_words(monkeypatch: pytest.MonkeyPatch) -> None:
    assert waits(iter([[]]), monkeypatch).states == []


def test_what_is_waited_for_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    report = waits(
        iter([["/navigate has a goal"], ["/grip is published", "/x is published"], []]), monkeypatch
    )
    assert [text for _, text, _ in report.states] == [
        "waits: /navigate has a goal",
        "waits: /grip is published, /x is published",
        "nothing is in progress",
    ]


def test_a_robot_that_is_never_idle_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        ClusterError, match=r"not idle within 0 s: /navigate has a goal; nothing was changed"
    ):
        waits(iter([["/navigate has a goal"]]), monkeypatch, seconds=0.0)


def test_ctrl_c_ends_the_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    cancel = Event()
    cancel.set()
    with pytest.raises(Interrupted, match="nothing was changed"):
        waits(iter([["/navigate"]] * 2), monkeypatch, cancel=cancel)
