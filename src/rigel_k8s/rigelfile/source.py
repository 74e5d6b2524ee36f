"""Text with places: every value of a Rigelfile has the place where it came from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import attrs

from rigel_k8s.problems import Path

_KINDS = {
    type(None): "nothing",
    bool: "a boolean",
    int: "a whole number",
    float: "a number",
    str: "text",
    list: "a list",
    dict: "a mapping",
}


@attrs.frozen
class Source:
    """A file's name as the user gave it, and its text."""

    name: str
    text: str
    lines: tuple[str, ...] = attrs.field(init=False, eq=False, repr=False)

    @lines.default
    def _split(self) -> tuple[str, ...]:
        return tuple(self.text.splitlines())


@attrs.frozen(order=True)
class Span:
    """A place in a text; lines and columns start at 1, the end is exclusive."""

    line: int
    column: int
    end_line: int
    end_column: int


@attrs.frozen
class YamlNode:
    """A YAML value with its place.

    Attributes:
        value: None, bool, int, float, str, or a list of Nodes, or a dict of key text to Node.
        span: the value's own place in the file (the place of use, for one from a template).
        raw: the text as written, for a scalar ("1.10" stays "1.10").
        key_span: the place of the key, for a value of a mapping.
        defined_at: the place of the var that gave the value, if a template gave it.
        key_defined_at: the key's place in that var, for a value inside of one.
        hole: a text that waits: with `{{ data.x }}` in it that only a run can fill, or with a
            template that is wrong and already reported. It stands for a value of any type.
        untyped: a text not written as one (from the environment, or made of several parts): it
            may become any type that the option needs, without loss.
        environment: the environment variable that gave the value.
        source: the text with the value and its key; None is the Rigelfile itself.
    """

    value: Any
    span: Span
    raw: str | None = None
    key_span: Span | None = None
    defined_at: Span | None = None
    key_defined_at: Span | None = None
    hole: bool = False
    untyped: bool = False
    environment: str | None = None
    source: Source | None = None

    def entries(self) -> Iterator[tuple[str | int, YamlNode]]:
        """Yield the keys or numbers of a mapping or list with their values."""
        if isinstance(self.value, dict):
            yield from self.value.items()
        elif isinstance(self.value, list):
            yield from enumerate(self.value)

    def children(self) -> Iterator[YamlNode]:
        """Yield the values of a mapping or list."""
        return (child for _, child in self.entries())

    def has_hole(self) -> bool:
        """Return whether a run has to fill in something in or below this value."""
        return self.hole or any(child.has_hole() for child in self.children())


def kind_of(value: Any) -> str:
    """Return a name for the kind of a Node's value: `a list`, `text`."""
    return _KINDS[next(kind for kind in _KINDS if isinstance(value, kind))]


def strip_places(node: YamlNode) -> Any:
    """Return the value without places: dicts, lists and scalars."""
    if isinstance(node.value, dict):
        return {key: strip_places(child) for key, child in node.value.items()}
    if isinstance(node.value, list):
        return [strip_places(child) for child in node.value]
    return node.value


def node_of(value: Any, at: YamlNode) -> YamlNode:
    """Return a Node of plain data with the place of another one.

    Raises:
        TypeError: the value is not data that YAML could hold.
    """
    if isinstance(value, dict):
        return attrs.evolve(at, value={str(k): node_of(v, at) for k, v in value.items()}, raw=None)
    if isinstance(value, list | tuple):
        return attrs.evolve(at, value=[node_of(item, at) for item in value], raw=None)
    if isinstance(value, str):
        return attrs.evolve(at, value=str(value), raw=str(value))
    if isinstance(value, bool):
        return attrs.evolve(at, value=value, raw=str(value).lower())
    if isinstance(value, int | float) or value is None:
        return attrs.evolve(at, value=value, raw="" if value is None else str(value))
    raise TypeError(f"{type(value).__name__} is not data")


def lay_over(base: YamlNode, over: YamlNode) -> YamlNode:
    """Return a value with another one laid over it: mappings by key, where null removes a key."""
    if not isinstance(base.value, dict) or not isinstance(over.value, dict):
        return over
    merged = dict(base.value)
    for key, value in over.value.items():
        if key in merged and value.value is None and not value.hole:
            del merged[key]
        else:
            merged[key] = lay_over(merged[key], value) if key in merged else value
    return attrs.evolve(base, value=merged)


def locate(root: YamlNode, path: Path) -> YamlNode:
    """Return the node at a path, or the nearest one above if the path does not exist."""
    node = root
    for step in path:
        if isinstance(node.value, dict) and str(step) in node.value:
            node = node.value[str(step)]
        elif isinstance(node.value, list) and isinstance(step, int) and step < len(node.value):
            node = node.value[step]
        else:
            break
    return node
