"""What Loki answers as entries and lines; the answers have the form of Loki 3.7's."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from rigel_k8s.commands.logs.stored import Asked, Stored
from rigel_k8s.observability.reading.loki import LokiClient, selector, windows

OF_ALL = {"application": "app", "container": "ros-node", "namespace": "lab", "node": "node2"}
TALKER = {**OF_ALL, "pod": "talker-1", "ros_node": "/talker", "workload": "talker"}
GONE = {**OF_ALL, "pod": "arm-0", "ros_node": "/lab/arm", "workload": "arm-7"}
EXPORTER = {**OF_ALL, "pod": "ros-exporter-1", "workload": "ros-exporter"}
TRACEBACK = (
    'Traceback (most recent call last):\n  File "<string>", line 13, in <module>\n'
    "IndexError: list index out of range\n"
)
RANGE = [
    {
        "stream": {**TALKER, "level": "error"},
        "values": [
            ["1795266201185150412", "[ERROR] [1795266201.184291]: failed 2340"],
            ["1795266201185224763", TRACEBACK],
        ],
    },
    {
        "stream": {**TALKER, "level": "warn"},
        "values": [
            ["1795266198672530960", "[WARN] [1795266198.672453]: late 2335"],
            ["1795266201182981799", "[WARN] [1795266201.182907]: late 2340"],
        ],
    },
]


class Answers:
    """Gives the recorded answers, and remembers what was asked."""

    def __init__(self) -> None:
        self.asked: list[Mapping[str, Any]] = []

    def __call__(self, path: str, query: Mapping[str, Any]) -> bytes:
        self.asked.append(query)
        series = path.endswith("series")
        data = [TALKER, GONE, EXPORTER] if series else {"resultType": "streams", "result": RANGE}
        return json.dumps({"status": "success", "data": data}).encode()


def stored(answers: Answers) -> Stored:
    own = {"application": "app", "namespace": "lab"}
    loki = LokiClient(answers)
    return Stored(loki, own, 10, 20, loki.series(selector(**own), 10, 20))


def test_a_selector_names_one_value_or_several() -> None:
    """As LogQL wants them; what is empty is not asked for."""
    made = selector(application="app", pod={"b-1", "a.b"}, level=frozenset())
    assert made == r'{application="app", pod=~"a\\.b|b\\-1"}'


def test_entries_of_several_streams_come_by_time() -> None:
    """Streams are answered one by one."""
    entries = list(LokiClient(Answers()).entries("{}", 0, 1))
    assert [entry.time for entry in entries] == sorted(entry.time for entry in entries)
    assert [entry.labels["level"] for entry in entries] == ["warn", "warn", "error", "error"]


def test_an_entry_of_several_lines_is_several_lines() -> None:
    """All with its time and level."""
    lines = list(stored(Answers()).lines(Asked(frozenset({"talker"})), frozenset(), None))
    last = lines[-1]
    assert [line.text for line in lines[-4:]] == TRACEBACK.split("\n")
    assert (last.level, last.ros_node, last.node) == ("error", "/talker", "node2")
    assert {line.time for line in lines[-4:]} == {1795266201185224763}


def test_the_question_is_as_narrow_as_can_be() -> None:
    """By workload, or by pod where one is named; levels are labels."""
    answers = Answers()
    found = stored(answers)
    list(found.lines(Asked(frozenset({"talker"})), {"error", "fatal"}, None))
    said = 'application="app", namespace="lab", workload=~"talker", level=~"error|fatal"'
    assert answers.asked[-1]["query"] == f"{{{said}}}"
    list(found.lines(Asked(frozenset(), frozenset({"arm-0"})), frozenset(), None))
    assert answers.asked[-1]["query"].endswith(r'pod=~"arm\\-0"}')
    list(found.lines(Asked(frozenset({"talker"})), frozenset(), 7))
    assert (answers.asked[-1]["direction"], answers.asked[-1]["limit"]) == ("backward", "7")


def test_nothing_is_asked_about_who_has_said_nothing() -> None:
    """Nor for no line at all."""
    answers = Answers()
    found = stored(answers)
    before = len(answers.asked)
    assert list(found.lines(Asked(frozenset({"silent"})), frozenset(), None)) == []
    assert list(found.lines(Asked(frozenset({"talker"})), frozenset(), 0)) == []
    assert len(answers.asked) == before


def test_nodes_that_are_gone_have_their_names() -> None:
    """ROS name, with or without its slash, Kubernetes name, pod; the exporter is no ROS node."""
    found = stored(Answers())
    assert found.workloads == {"talker", "arm-7"}
    for name in ("lab/arm", "/lab/arm", "arm-7", "arm_7"):
        assert found.resolve_name(name) == Asked(frozenset({"arm-7"}))
    assert found.resolve_name("arm-0") == Asked(frozenset(), frozenset({"arm-0"}))
    assert found.resolve_name("arm") is None


def test_a_long_time_is_asked_for_in_pieces() -> None:
    """Loki takes 30 days at once; the pieces leave nothing out."""
    day = 24 * 3600 * 10**9
    assert windows(0, 31 * day) == [(0, 30 * day), (30 * day, 31 * day)]
    assert windows(5, 6) == [(5, 6)]
