"""Splits texts with `{{ ... }}` into pieces; nothing is looked up here.

A plain name is what Rigel supports: `{{ vars.NAME }}` or `{{ data.NAME }}`, with letters, digits
and `_-!?.` in the name. Anything else between the braces is an expression (expression.py).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TypeAlias

import attrs

HEADERS = ("vars", "data")

_PLAIN = re.compile(r"\{\{\s*([a-zA-Z0-9_\-!?.]+)\s*\}\}")
_TOKEN = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|[{}]""", re.DOTALL)


@attrs.frozen
class Name:
    """A plain name.

    Attributes:
        text: the whole template, braces included.
        header: the part before the first dot; empty without a dot.
        name: the part after it.
    """

    text: str
    header: str
    name: str


@attrs.frozen
class Expression:
    """Anything else between braces."""

    text: str
    source: str


@attrs.frozen
class Unclosed:
    """Braces that are never closed, up to the end of the text."""

    text: str


Part: TypeAlias = str | Name | Expression | Unclosed


def parts(text: str) -> Iterator[Part]:
    """Yield the pieces of a text in order."""
    place = 0
    while True:
        start = text.find("{{", place)
        if start < 0:
            break
        if start > place:
            yield text[place:start]
        template = _template(text, start)
        yield template
        place = start + len(template.text)
    if place < len(text):
        yield text[place:]


def _template(text: str, start: int) -> Name | Expression | Unclosed:
    plain = _PLAIN.match(text, start)
    if plain:
        return Name(plain[0], *split(plain[1]))
    end = _end(text, start + 2)
    if end is None:
        return Unclosed(text[start:])
    return Expression(text[start:end], text[start + 2 : end - 2].strip())


def split(name: str) -> tuple[str, str]:
    """Return a plain name's header and the rest."""
    header, dot, rest = name.partition(".")
    return (header, rest) if dot else ("", name)


def _end(text: str, place: int) -> int | None:
    """Return where the template ends; quotes and braces inside it hide its end."""
    depth = 0
    for token in _TOKEN.finditer(text, place):
        if token[0] == "{":
            depth += 1
        elif token[0] == "}" and depth:
            depth -= 1
        elif token[0] == "}" and text.startswith("}}", token.start()):
            return token.start() + 2
    return None
