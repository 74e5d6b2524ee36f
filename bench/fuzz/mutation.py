"""Rigelfiles broken at random places; the same seed gives the same file on every machine."""

from __future__ import annotations

import copy
import pickle
import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
#: Larger files take too long to be changed a million times.
LARGEST = 6000
PIECES = (
    *("{{ vars.x }}", "{{ data.x }}", "{{ vars.image | upper }}", "{{", "}}", "{{ 'a' * 10**9 }}"),
    *(
        "[",
        "]",
        "{",
        "}",
        ": ",
        "- ",
        "\n",
        "  ",
        "\t",
        '"',
        "'",
        "#",
        "| ",
        "? ",
        "\0",
        "\x1b",
        "\ufeff",
    ),
    *(
        "null",
        "yes",
        "1.10",
        "&a ",
        "*a",
        "<<: ",
        "!!int ",
        "!!float ",
        "!!binary ",
        "name",
        "jobs",
    ),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 1.5, 2**31, 2**63, 10**40, 1e308, float("inf"), float("nan")),
    *(
        "",
        " ",
        "x" * 300,
        "-",
        "/",
        "..",
        "../../etc/passwd",
        "/dev/zero",
        "\x1b[2J",
        "\u202e",
        "\u0663",
    ),
    *("{{ vars.x }}", "{{ vars.PATH }}", "{{ data.x }}", "{{ 10**99 }}", "{{ 'a' * 10**9 }}", "{{"),
    *(
        "{{ range(99) | list }}",
        "{{ {'a': 1} }}",
        "1e999",
        "1:30",
        "0x1f",
        "1_000",
        ".inf",
        "9" * 500,
    ),
    *(
        "100%",
        "5m",
        "64Mi",
        "0.0.0.0/0",
        "300.1.1.1",
        "::/0",
        "http://a:99999",
        "a:b:c@d",
        "localhost:0/a",
    ),
    *([], {}, [[]], [None], {"a": None}, {"": ""}, [{}, {}], {"x": {"y": {"z": 1}}}),
)


def seeds() -> list[str]:
    """Return the texts that are changed: the examples, and the Rigelfiles of the unit tests."""
    places = (
        *(ROOT / "examples").glob("*/Rigelfile*"),
        *(ROOT / "tests/unit/rigelfile").glob("*/*.Rigelfile"),
    )
    found = (path.read_text("utf-8", errors="replace") for path in sorted(places))
    return [
        text.replace("test.", "rigel_k8s.")
        for text in found
        if len(text) < LARGEST and text.count("*d") < 9
    ]  # aliases that multiply never end here


def mutate(texts: list[str], seed: str) -> bytes:
    """Return the file of a seed."""
    chance = random.Random(seed)
    text = chance.choice(texts)
    if chance.random() < 0.6:
        return _change_structure(text, texts, chance).encode("utf-8", "surrogatepass")
    content = bytearray(text.encode())
    for _ in range(chance.randint(1, 5)):
        _change_bytes(content, chance)
    return bytes(content)


def _change_bytes(content: bytearray, chance: random.Random) -> None:
    place = chance.randrange(len(content) + 1)
    way = chance.random()
    if way < 0.5:
        content[place:place] = chance.choice(PIECES).encode()
    elif way < 0.7:
        del content[place : place + chance.randint(1, 12)]
    elif way < 0.85:
        start = chance.randrange(len(content) + 1)
        content[place:place] = content[start : start + chance.randint(1, 80)]
    else:
        content[place : place + 1] = bytes([chance.randrange(256)])


def _change_structure(text: str, texts: list[str], chance: random.Random) -> str:
    """Swap, remove, double and replace values, of this file and of another."""
    try:
        root, other = load(text), load(chance.choice(texts))
    except (yaml.YAMLError, ValueError, RecursionError):
        return text + chance.choice(PIECES)
    for _ in range(chance.randint(1, 4)):
        places = list(_places(root))
        if not places:
            break
        holder, key = chance.choice(places)
        way = chance.random()
        if way < 0.5:
            holder[key] = copy.deepcopy(chance.choice(VALUES))
        elif way < 0.7:
            away, there = chance.choice(list(_places(other)) or [(holder, key)])
            holder[key] = copy.deepcopy(away[there])
        elif way < 0.8:
            del holder[key]
        elif way < 0.9 and isinstance(holder, dict):
            holder[chance.choice([1, 1.5, None, "", "{{ vars.x }}", "x y", *holder])] = holder.pop(
                key
            )
        else:
            holder[key] = [holder[key], copy.deepcopy(holder[key])]
    return str(yaml.dump(root, Dumper=yaml.CSafeDumper, allow_unicode=True, sort_keys=False))


def load(text: str) -> Any:
    """Return what a file contains; each call returns values of its own."""
    return pickle.loads(_read(text))


@cache
def _read(text: str) -> bytes:
    return pickle.dumps(yaml.load(text, Loader=yaml.CSafeLoader))


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield (container, key) of every value below."""
    keys = (
        value.keys()
        if isinstance(value, dict)
        else range(len(value) if isinstance(value, list) else 0)
    )
    for key in keys:
        yield value, key
        yield from _places(value[key])
