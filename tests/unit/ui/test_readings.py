"""What a page reads once: as the command line reads and writes it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from rigel_graph.commands.params import Parameters
from rigel_ui import readings
from rigel_ui.readings import Readings, list_kinds


def test_a_message_is_that_of_echo(monkeypatch: pytest.MonkeyPatch) -> None:
    """One, shortened, within a time; a pod that ends before it is no bug of ours."""
    given: list[Any] = [{"message": {"b": [1, "..."], "a": "x..."}, "shortened": True}]
    asked = []

    def follow(found: Any, topic: str, **how: Any) -> Iterator[Any]:
        asked.append((found, topic, how))
        return iter(given)

    monkeypatch.setattr(readings, "follow", follow)
    found: Any = "a release"
    read = Readings(list_kinds(found)).read
    answer = dict(read("message", "/scan"))
    assert answer.pop("read").endswith("Z")
    assert answer == {"text": "b:\n- 1\n- '...'\na: x...", "shortened": True}
    assert asked == [(found, "/scan", {"count": 1, "most": 128, "within": 20.0})]
    given.clear()
    assert read("message", "/scan") == {
        "error": "the pod has ended before a message came\ntry again"
    }


def test_parameters_are_those_of_the_list(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each value as YAML in flow style."""
    values = {"speed": 2.5, "names": ["a", "true"], "text": "x...", "unset": None}
    monkeypatch.setattr(readings, "read_parameters", lambda _, node, __: Parameters(node, values))
    found: Any = "a release"
    answer = Readings(list_kinds(found)).read("parameters", "/driver")
    assert answer["rows"] == [
        ["speed", "2.5"],
        ["names", "[a, 'true']"],
        ["text", "x..."],
        ["unset", "null"],
    ]
