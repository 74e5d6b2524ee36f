"""Rendered YAML says the same to every reader."""

from __future__ import annotations

import pytest
import yaml

from rigel_k8s.commands.yaml_text import documents

#: What PyYAML writes unquoted and another reader takes for something else, and the other way round.
MISTAKABLE = [
    "y",
    "n",
    "yes",
    "No",
    "on",
    "OFF",
    "true",
    "null",
    "~",
    "",
    "1e3",
    "0o17",
    "0x1F",
    "017",
]
MISTAKABLE += [
    "1_000",
    "12:30:45",
    "2026-11-21",
    "1.10",
    ".5",
    "+1",
    "-",
    ".inf",
    ".NaN",
    "<<",
    "=",
    "-0",
]


@pytest.mark.parametrize("value", MISTAKABLE)
def test_text_that_a_reader_could_mistake_is_quoted(value: str) -> None:
    """kubectl reads `n` as false and 1e3 as a number; in quotes they stay text for everyone."""
    text = documents([{"data": {"key": value}}])
    assert f'key: "{value}"' in text or f"key: '{value}'" in text
    assert yaml.safe_load(text) == {"data": {"key": value}}


def test_numbers_and_booleans_stay_what_they_are() -> None:
    """Only text is quoted."""
    text = documents([{"replicas": 3, "readOnly": True, "share": 0.5, "nothing": None}])
    assert yaml.safe_load(text) == {"replicas": 3, "readOnly": True, "share": 0.5, "nothing": None}
    assert "replicas: 3\n" in text
    assert "readOnly: true\n" in text


def test_scripts_are_blocks() -> None:
    """A text of several lines can be read as such, and comes back to the letter."""
    script = "#!/bin/sh\necho hello\n\nexit 0\n"
    text = documents([{"data": {"run.sh": script}}])
    assert "run.sh: |" in text
    assert yaml.safe_load(text)["data"]["run.sh"] == script


@pytest.mark.parametrize(
    "value", ["a \nb", "\ttab\n", "trailing  \n", "\n\n", "a\r\nb", "é\n", "#x: y"]
)
def test_any_text_comes_back_to_the_letter(value: str) -> None:
    """Whatever the form, reading gives the same text."""
    assert yaml.safe_load(documents([{"v": value}])) == {"v": value}


def test_repeated_parts_are_written_out() -> None:
    """No anchors: two objects that share a mapping are whole each."""
    shared = {"app": "talker"}
    text = documents([{"selector": shared, "labels": shared}])
    assert "&" not in text
    assert "*" not in text


def test_each_object_is_a_document() -> None:
    """The text can be piped to kubectl apply -f -."""
    text = documents([{"kind": "A"}, {"kind": "B"}])
    assert [d["kind"] for d in yaml.safe_load_all(text)] == ["A", "B"]
