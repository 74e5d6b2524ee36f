"""Puts values in the place of templates; they keep the place where they were written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import attrs

from rigel_k8s.rigelfile.numbers import keep_text
from rigel_k8s.rigelfile.source import Source, Span, YamlNode


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
    lines = source.lines
    for found in find_occurrences(lines, span, text):
        if number == 0:
            return found
        number -= 1
    return span


def find_occurrences(lines: Sequence[str], span: Span, text: str) -> Iterator[Span]:
    """Yield the places of a text inside a span, in order."""
    for line in range(span.line, min(span.end_line, len(lines)) + 1):
        content = lines[line - 1]
        column = content.find(text, span.column - 1 if line == span.line else 0)
        while column >= 0:
            yield Span(line, column + 1, line, column + 1 + len(text))
            column = content.find(text, column + 1)
