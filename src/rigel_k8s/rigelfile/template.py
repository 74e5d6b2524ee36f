"""Templates as text: split into pieces, and put together again with values; nothing is looked up.

A plain name is what Rigel supports: `{{ vars.NAME }}` or `{{ data.NAME }}`, with letters, digits
and `_-!?.` in the name. Anything else between the braces is an expression (expression.py). A value
in the place of a template keeps the place where it was written.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, TypeAlias

import attrs

from rigel_k8s.rigelfile.scalars import keep_text
from rigel_k8s.rigelfile.source import Source, Span, YamlNode

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


def split(text: str) -> Iterator[Part]:
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
        header, dot, name = plain[1].partition(".")
        return Name(plain[0], header, name) if dot else Name(plain[0], "", header)
    end = _end(text, start + 2)
    if end is None:
        return Unclosed(text[start:])
    return Expression(text[start:end], text[start + 2 : end - 2].strip())


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


def place_value(use: YamlNode, value: YamlNode) -> YamlNode:
    """Return a var's value where it is used."""
    return attrs.evolve(move(use, value), key_span=use.key_span, key_defined_at=use.key_defined_at)


def move(use: YamlNode, value: YamlNode) -> YamlNode:
    """Return a value, its place and all places in it as the definition of what is used."""
    inner: Any = value.value
    if isinstance(inner, dict):
        inner = {key: move(use, child) for key, child in inner.items()}
    elif isinstance(inner, list):
        inner = [move(use, child) for child in inner]
    here = value.span == use.span
    return attrs.evolve(
        value,
        value=inner,
        span=use.span,
        defined_at=value.defined_at or (None if here or value.environment else value.span),
        key_span=use.span,
        key_defined_at=value.key_defined_at or (None if here else value.key_span),
    )


def add_origin(result: YamlNode, found: list[YamlNode]) -> YamlNode:
    """Return the node with the origin of the first value that it was made from."""
    for value in found:
        if value.environment:
            return attrs.evolve(result, environment=value.environment, untyped=True)
        if value.span != result.span:
            return attrs.evolve(result, defined_at=value.defined_at or value.span)
    return result


def convert_numbers(node: YamlNode) -> Any:
    """Return plain data whose numbers remember how they were written."""
    if isinstance(node.value, dict):
        return {key: convert_numbers(child) for key, child in node.value.items()}
    if isinstance(node.value, list):
        return [convert_numbers(child) for child in node.value]
    return keep_text(node.value, node.raw)


def read_text(node: YamlNode) -> str:
    """Return a value as the text that it was written as."""
    if isinstance(node.value, str):
        return node.value
    return node.raw or ""


def join(node: YamlNode, values: list[YamlNode]) -> YamlNode:
    """Return one text of several pieces, with the origin of the first from elsewhere."""
    text = "".join(map(read_text, values))
    joined = attrs.evolve(node, value=text, raw=text, untyped=True)
    for value in values:
        if value.defined_at or value.environment:
            defined = node.defined_at or value.defined_at
            return attrs.evolve(joined, defined_at=defined, environment=value.environment)
    return joined


def find_span(source: Source, node: YamlNode, text: str, number: int) -> Span:
    """Return the place of the number-th occurrence of a text inside a scalar, if it is there."""
    span = node.span
    for line in range(span.line, min(span.end_line, len(source.lines)) + 1):
        content = source.lines[line - 1]
        column = content.find(text, span.column - 1 if line == span.line else 0)
        while column >= 0:
            if number == 0:
                return Span(line, column + 1, line, column + 1 + len(text))
            number -= 1
            column = content.find(text, column + 1)
    return span
