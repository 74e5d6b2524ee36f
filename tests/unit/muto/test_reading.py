"""JSON is read as JSON, with the places of its values."""

from __future__ import annotations

import base64
import gzip
import json

import pytest

from rigel_k8s.rigelfile.limits import MOST_BYTES
from rigel_k8s.rigelfile.source import Source, Span, YamlNode, locate, strip_places
from rigel_muto.parameters import give_type
from rigel_muto.reading import decode, read
from rigel_muto.remarks import Unreadable

TEXTS = [
    '{\n\t"a":\t"b",\n\t"c": [1, 2.5],\n\t"d": {"e": null}\n}',
    '{"a":"b","c":{"x":1e3,"y":-1.5E-3,"z":"1e3","n":-0}}',
    r'{"a": "x\/y \u00e4 \n \" \\"}',
    r'{"a": "\ud83d\ude00", "b": "\\ud83d\\ude00", "c": "\\\ud83d\ude00"}',
    '{"a": "~", "b": "yes", "c": "=", "<<": {"d": true}, "e": "2001-01-01", "f": "010"}',
    '{"a": "# no comment: {}", "b": "%"}',
]


@pytest.mark.parametrize("text", TEXTS)
def test_json_means_what_json_says(text: str) -> None:
    """Although YAML would read some of it otherwise."""
    got = strip_places(read(Source("stack.json", text)))
    assert json.dumps(got) == json.dumps(json.loads(text))


def test_each_value_has_its_place() -> None:
    """Line and column of the value and of its key, in the stack's own text."""
    source = Source("stack.json", '{\n "node": [{"name": 1e3}]\n}')
    name = locate(read(source), ("node", 0, "name"))
    assert (name.value, name.span, name.source) == (1000.0, Span(2, 20, 2, 23), source)
    assert name.key_span == Span(2, 12, 2, 18)


@pytest.mark.parametrize("text", [r'{"a": "\ud83d"}', '{"a": 1} {"b": 2}', "{", "[" * 200])
def test_what_cannot_be_read_says_why(text: str) -> None:
    with pytest.raises(Unreadable):
        read(Source("stack.json", text))


def test_what_is_compressed_is_not_larger_than_a_rigelfile() -> None:
    """A few bytes can hold gigabytes."""
    bomb = base64.b64encode(gzip.compress(b" " * (MOST_BYTES + 1))).decode()
    with pytest.raises(Unreadable, match="has more than"):
        decode(YamlNode(bomb, Span(1, 1, 1, 2)), "a bomb")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2),
        ("-3", -3),
        ("010", 10),
        ("2.5", 2.5),
        ("1e3", 1000.0),
        (".5", 0.5),
        ("True", True),
        ("false", False),
        ("yes", "yes"),
        ("", ""),
        ("2 m", "2 m"),
        ("[1, 2]", "[1, 2]"),
        ("0x10", "0x10"),
        ("1_000", "1_000"),
        ("nan", "nan"),
        ("9" * 5000, "9" * 5000),
    ],
)
def test_a_parameters_text_becomes_what_it_is_written_as(text: str, value: object) -> None:
    """A number or a truth, as Muto's ROS 2 generation has it; all else stays text."""
    typed = give_type(YamlNode(text, Span(1, 1, 1, 2))).value
    assert (typed, type(typed)) == (value, type(value))
