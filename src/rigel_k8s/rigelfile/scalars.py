"""Converts single values to an option's type, without loss: `1.10` may be text, `true` is not 1."""

from __future__ import annotations

import enum
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.rigelfile.fields import (
    choices,
    describe_type,
    fields_by_key,
    is_list,
    is_mapping,
    is_scalar_class,
    members,
    unwrap,
)
from rigel_k8s.rigelfile.findings import find_nearest, name_nearest
from rigel_k8s.rigelfile.source import YamlNode, kind_of

_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
_WHOLE = re.compile(r"[+-]?\d+")
_BOOLEANS = {
    **dict.fromkeys(("true", "yes", "on"), True),
    **dict.fromkeys(("false", "no", "off"), False),
}


class Mismatch(Exception):
    """A value that does not fit an option's type."""

    def __init__(self, message: str, kind: str = "wrong-type") -> None:
        super().__init__(message)
        self.message = message
        self.kind = kind


def scalar(node: YamlNode, kind: Any) -> Any:
    """Return the value of a scalar type.

    Raises:
        Mismatch: the value does not fit, with what would.
    """
    if choices(kind) is not None:
        return _choice(node, kind)
    if is_scalar_class(kind):
        return _parse(node, kind)
    if kind is bool:
        return _boolean(node)
    if kind is int:
        return _whole(node, kind)
    if kind is float:
        return _number(node, kind)
    if kind is str:
        return _text(node, kind)
    if kind is Path:
        return Path(_text(node, kind))
    if kind is type(None) and node.value is None:
        return None
    raise mismatch(node, kind)


def mismatch(node: YamlNode, kind: Any, hint: str = "") -> Mismatch:
    """Return the error for a value that is not of a type."""
    if node.value is None:
        message = f"expected {describe_type(kind)}, got nothing: write a value or remove the key"
        return Mismatch(message, "no-value")
    hint = hint or _find_example(node, kind)
    return Mismatch(f"expected {describe_type(kind)}, got {describe(node)}{hint}")


def _find_example(node: YamlNode, kind: Any) -> str:
    """Return what to write where a mapping is expected, "" if its class has no example."""
    for member in members(unwrap(kind)):
        if hint := getattr(member, "explain", lambda _: "")(node.raw or ""):
            return str(hint)
        if example := getattr(member, "example", None):
            return f": write {example}"
        if is_mapping(member) and isinstance(node.value, list):
            return ": write each entry as a key"
    return ""


def describe(node: YamlNode) -> str:
    """Return a value's description for a message: `the text "x"`, `a list`."""
    if isinstance(node.value, dict | list) or node.value is None:
        return kind_of(node.value)
    text = node.raw if node.raw is not None else str(node.value)
    shown = text if len(text) <= 40 else f"{text[:37]}..."
    if isinstance(node.value, str):
        return f'the text "{shown}"'
    return f"the boolean {shown}" if isinstance(node.value, bool) else shown


def _text(node: YamlNode, kind: Any) -> str:
    if isinstance(node.value, str):
        return node.value
    if isinstance(node.value, bool):
        raise Mismatch(
            f"{node.raw} without quotes is a boolean in YAML,"
            f' and {describe_type(kind)} is expected: write "{node.raw}"',
            "yaml-boolean",
        )
    if isinstance(node.value, int | float) and node.raw is not None:
        return node.raw
    raise mismatch(node, kind)


def _whole(node: YamlNode, kind: Any) -> int:
    _refuse_base_60(node)
    if isinstance(node.value, int) and not isinstance(node.value, bool):
        return node.value
    if isinstance(node.value, str) and _WHOLE.fullmatch(node.value.strip()):
        if node.untyped:
            return int(node.value)
        raise mismatch(node, kind, ": remove the quotes")
    raise mismatch(node, kind)


def _number(node: YamlNode, kind: Any) -> float:
    _refuse_base_60(node)
    if isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    if isinstance(node.value, str):
        try:
            value = float(node.value)
        except ValueError:
            raise mismatch(node, kind) from None
        if node.untyped:
            return value
        raise mismatch(node, kind, f": write {value} without quotes")
    raise mismatch(node, kind)


def _refuse_base_60(node: YamlNode) -> None:
    if isinstance(node.value, int | float) and (trap := find_trap(node)):
        raise Mismatch(trap)


def find_trap(node: YamlNode) -> str | None:
    """Return what YAML 1.1 makes of a number: of 22:30 it is 1350, and of 1e-3 a text."""
    raw, span = node.raw or "", node.defined_at or node.span
    if isinstance(node.value, int | float) and ":" in raw:
        return f"{raw} is {node.value} in YAML: write that, or quote it if it is text"
    is_quoted = span.end_column - span.column != len(raw)
    if isinstance(node.value, str) and _EXPONENT.fullmatch(raw) and not is_quoted:
        number = repr(float(raw))
        shown = number if "." in number else number.replace("e", ".0e")
        return f"{raw} is text in YAML: write {shown}, or quote it"
    return None


def _boolean(node: YamlNode) -> bool:
    if isinstance(node.value, bool):
        return node.value
    if isinstance(node.value, str) and node.value.strip().lower() in _BOOLEANS:
        if node.untyped:
            return _BOOLEANS[node.value.strip().lower()]
        raise mismatch(node, bool, ": remove the quotes")
    raise mismatch(node, bool)


def _parse(node: YamlNode, kind: Any) -> Any:
    if issubclass(kind, str):
        raw = _text(node, kind)
    elif issubclass(kind, int):
        raw = str(int(_whole(node, kind)))
    else:
        raw = str(_number(node, kind))
    try:
        return kind.parse(raw)
    except ValueError as error:
        raise Mismatch(str(error), getattr(kind, "kind", "bad-value")) from error


def _choice(node: YamlNode, kind: Any) -> Any:
    known = {str(value): value for value in choices(kind) or ()}
    if isinstance(node.value, bool) and node.raw not in known:
        text = str(node.value)  # a choice may be a boolean itself
        if not isinstance(known.get(text), bool):
            raise mismatch(node, kind)
    elif isinstance(node.value, dict | list) or node.value is None:
        raise mismatch(node, kind)
    else:
        text = _text(node, kind)
    if text not in known:
        hint = name_nearest(text, known)
        raise Mismatch(f'"{text}" is not {describe_type(kind)}{hint}', "bad-choice")
    is_enum = isinstance(kind, type) and issubclass(kind, enum.Enum)
    return kind(known[text]) if is_enum else known[text]


def is_yes_or_no(node: YamlNode) -> bool:
    """Return whether a boolean is written as in YAML 1.1 only: yes, on, y."""
    return isinstance(node.value, bool) and (node.raw or "true").lower() not in ("true", "false")


@cache
def find_candidates(kinds: tuple[Any, ...], given: type[Any]) -> tuple[Any, ...]:
    """Return the members of a union that a value of a Python type may be, the most direct first."""
    candidates = [kind for kind in kinds if kind is not type(None) and _may_be(given, kind)]
    return tuple(sorted(candidates, key=lambda kind: _rank(given, kind)))


def _may_be(given: type[Any], kind: Any) -> bool:
    """Return whether a member of a union is of the value's kind at all."""
    if kind is Any:
        return True
    if issubclass(given, dict):
        return is_mapping(kind) or (isinstance(kind, type) and attrs.has(kind))
    if issubclass(given, list):
        return is_list(kind)
    is_container = is_mapping(kind) or is_list(kind) or attrs.has(kind)
    return not is_container and not issubclass(given, type(None))


def find_ambiguity(node: YamlNode, kinds: tuple[Any, ...]) -> Mismatch | None:
    """Return how to write a list of one, if only lists or mappings fit a single value."""
    if isinstance(node.value, dict | list) or node.value is None or not node.raw:
        return None
    lists = [kind for kind in kinds if is_list(kind)]
    return mismatch(node, lists[0], f": write [{node.raw}]") if len(lists) == 1 else None


def _rank(given: type[Any], kind: Any) -> int:
    """Order the members of a union by how directly a scalar is one of them."""
    if kind is Any:
        return 4
    base = next((b for b in (bool, int, float, str) if is_a(kind, b)), str)
    if issubclass(given, bool):
        return 0 if base is bool else 3
    if issubclass(given, str):
        return 1 if base is str and kind is str else 0 if base is str else 2
    same = int if issubclass(given, int) else float
    return 0 if base is same else 1 if base is float else 2


def is_a(kind: Any, base: type[Any]) -> bool:
    """Return whether a type is one of these."""
    return isinstance(kind, type) and issubclass(kind, base)


def choose_by_keys(node: YamlNode, candidates: Sequence[Any]) -> Any:
    """Return the member that has most of a mapping's keys, near misses counted less."""
    classes = [kind for kind in candidates if isinstance(kind, type) and attrs.has(kind)]
    if len(classes) < 2:
        return classes[0] if classes else candidates[0]

    def score(cls: Any) -> tuple[int, int]:
        known = fields_by_key(cls).keys()
        missed = [key for key in node.value if key not in known]
        near = sum(1 for key in missed if find_nearest(key, known - node.value.keys()))
        return len(node.value) - len(missed), near

    return max(classes, key=score)


class _Written:
    """A number that remembers how it was written: 1.10 is a version for some and 1.1 for others.

    It is a float or int in every calculation; only `str()` returns the text of the Rigelfile.
    """

    raw: str

    def __str__(self) -> str:
        return self.raw


class WrittenFloat(_Written, float):
    """A float with its text."""


class WrittenInt(_Written, int):
    """An int with its text."""


def keep_text(value: Any, raw: str | None) -> Any:
    """Return a number that keeps its text if the text would be lost; other values unchanged."""
    if raw is None or isinstance(value, bool) or str(value) == raw:
        return value
    number: WrittenFloat | WrittenInt
    if isinstance(value, float):
        number = WrittenFloat(value)
    elif isinstance(value, int):
        number = WrittenInt(value)
    else:
        return value
    number.raw = raw
    return number
