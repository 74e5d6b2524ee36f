"""`rigel logs --since --level` with a real Loki, and without one."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef

from ...background import Background
from .conftest import App, until

pytestmark = pytest.mark.cluster


def numbers(lines: list[dict[str, Any]]) -> dict[str, list[int]]:
    """Return the talker's numbers, by pod, in the order in which they were told."""
    found: dict[str, list[int]] = {}
    for line in lines:
        if said := re.search(r": said (\d+)$", line["text"]):
            found.setdefault(line["pod"], []).append(int(said[1]))
    return found


def test_lines_of_a_pod_that_is_gone_are_found(app: App, cluster: Any) -> None:
    """With their levels and tracebacks; nothing is missing or there twice."""
    [old] = until(lambda: {x["pod"] for x in app.lines("--since", "1h", "talker")}, "its lines")

    def has_failed() -> bool:
        return any(line["pod"] == old for line in app.lines("--level", "error", "talker"))

    until(has_failed, "an error of the talker")
    cluster.delete(ObjectRef("v1", "Pod", app.namespace, old))
    until(lambda: cluster.get(ObjectRef("v1", "Pod", app.namespace, old)) is None, "the pod's end")
    until(lambda: len(numbers(app.lines("--since", "1h", "talker"))) > 1, "the next pod's lines")

    errors = [
        x for x in app.lines("--since", "1h", "--level", "error", "talker") if x["pod"] == old
    ]
    assert {line["level"] for line in errors} == {"error"}
    assert any("failed 20" in line["text"] for line in errors)
    assert any("IndexError" in line["text"] for line in errors), "its traceback"
    assert not any("late" in line["text"] for line in errors)
    assert errors[0]["ros_name"] == "/talker"
    assert errors[0]["node"]
    everything = app.lines("--since", "1h", "talker")
    for said in numbers(everything).values():
        assert said == list(range(1, len(said) + 1))
    assert "failed 20" in app("logs", "--level", "error", old).stdout, "by the pod's name too"


def test_more_lines_than_loki_gives_at_once(app: App) -> None:
    """All of them, once and in order; and the last ones without reading the others."""

    def flood(*words: str) -> list[int]:
        texts = [line["text"] for line in app.lines("--since", "1h", *words, "shouter")]
        return [int(text.split()[1]) for text in texts if text.startswith("flood ")]

    found = until(lambda: (lines := flood())[-1:] == [11999] and lines, "the last line")
    assert found == list(range(12000))
    last = flood("--tail", "50")
    assert last == list(range(12000 - len(last), 12000))
    assert 30 < len(last) <= 50


def test_without_loki_the_lines_are_the_same(app: App, limited: Callable[..., App]) -> None:
    """Of existing containers; a stack that may not be asked is named."""
    someone = limited()
    told = someone("logs", "--since", "1h", "--level", "warn", "talker")
    assert all("only the lines of existing containers" in one for one in told.stderr.splitlines())

    def existing() -> list[dict[str, Any]] | None:
        """Its lines, once there is one of each level: its pod may be new."""
        done = someone("logs", "--level", "warn", "-o", "json", "talker")
        found = [json.loads(line) for line in done.stdout.splitlines()]
        return found if any(line["level"] == "error" for line in found) else None

    lines = until(existing, "an error of the talker")
    assert {line["level"] for line in lines} == {"warn", "error"}
    pod, last = lines[0]["pod"], lines[-1]["time"]
    first = lines[0]["time"]
    wanted = Counter(line["text"] for line in lines)

    def stored() -> Counter[str]:
        """What Loki has of them: a line arrives there a moment after it was said."""
        return Counter(
            line["text"]
            for line in app.lines("--level", "warn", "talker")
            if line["pod"] == pod and first <= line["time"] <= last
        )

    until(lambda: stored().total() >= wanted.total(), "the last line in Loki")
    assert stored() == wanted


def test_follow_goes_on_where_the_past_ends(
    app: App, cluster: Any, start: Callable[..., Background]
) -> None:
    """Past lines of the container and what comes: nothing is missing or there twice, also in the
    next pod."""
    running = start(app.command("logs", "-f", "--since", "1m", "-o", "json", "talker"))

    def lines() -> list[dict[str, Any]]:
        return [json.loads(line) for line in list(running.lines) if line.startswith("{")]

    until(lambda: running.lines, "the first line")
    before = len(running.lines)
    until(lambda: len(running.lines) > before + 20, "lines as they come")
    pods = cluster.list("v1", "Pod", app.namespace, labels={"app.kubernetes.io/name": "talker"})
    for pod in pods:
        cluster.delete(ObjectRef("v1", "Pod", app.namespace, pod["metadata"]["name"]))
    seen = set(numbers(lines()))
    until(lambda: set(numbers(lines())) - seen, "lines of the next pod")
    assert running.interrupt() == 130
    found = lines()
    for said in numbers(found).values():
        assert said == list(range(said[0], said[0] + len(said)))
    failed = sum("failed" in line["text"] for line in found)
    assert sum(line["text"] == "IndexError: list index out of range" for line in found) == failed
