"""Rendered YAML says the same to every reader."""

from __future__ import annotations

import time
from typing import Any

import pytest
import yaml

from rigel_k8s import yaml_text
from rigel_k8s.yaml_text import document, documents

MANIFEST: dict[str, Any] = {
    "metadata": {"name": "talker", "labels": {}, "annotations": {"n": "1e3", "when": "12:30"}},
    "spec": {
        "containers": [{"command": ["sh", "-c", "a\nb\n"], "ports": [], "tty": True, "cpu": 0.5}],
        "expiry": None,
        "replicas": -1,
        "share": 1.0,
        "emoji": "é 😀 # ' \" \\",
    },
}

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
    "2026-01-02T03:04:05Z",
    "2026-01-02 03:04:05",
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


def test_a_mapping_alone_has_no_mark_of_a_document() -> None:
    """A kubeconfig is one document; its keys stay in their order."""
    assert document({"kind": "Config", "apiVersion": "v1"}) == "kind: Config\napiVersion: v1\n"
    assert document({}) == "{}\n"


def test_a_text_and_a_number_that_look_alike_are_kept_apart() -> None:
    """Also where one was written before: 1, 1.0, True and "1" are four values."""
    data = {"a": 1, "b": 1.0, "c": True, "d": "1", "e": 0, "f": False, "g": "0"}
    assert document(data) == 'a: 1\nb: 1.0\nc: true\nd: "1"\ne: 0\nf: false\ng: "0"\n'


def test_without_libyaml_the_text_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyYAML can be built without it; a manifest does not change for it."""
    fast = documents([MANIFEST])
    monkeypatch.setattr(yaml_text, "Dumper", yaml.SafeDumper)
    assert documents([MANIFEST]) == fast
    assert yaml.safe_load(fast) == MANIFEST


def test_writing_takes_a_fraction_of_what_pyyaml_needs() -> None:
    """A release of a thousand nodes is 140,000 values."""
    if not yaml.__with_libyaml__:
        pytest.skip("PyYAML was built without LibYAML")
    objects = [{**MANIFEST, "index": index} for index in range(300)]

    def cost(write: Any) -> float:
        start = time.thread_time()
        write(objects)
        return time.thread_time() - start

    def slow(objects: list[Any]) -> str:
        return str(yaml.dump_all(objects, Dumper=yaml.SafeDumper))

    assert min(cost(documents) for _ in range(3)) < min(cost(slow) for _ in range(3)) / 5
