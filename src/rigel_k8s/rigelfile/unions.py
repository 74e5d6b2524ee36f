"""Which member of a union a value belongs to: by its kind, its text, its keys; pure.

It reads one Node and never its children's values; structure.py tries what is chosen here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import attrs

from rigel_k8s.rigelfile.fields import fields_by_key, is_list, is_mapping
from rigel_k8s.rigelfile.findings import find_nearest
from rigel_k8s.rigelfile.scalars import Mismatch, mismatch
from rigel_k8s.rigelfile.source import YamlNode


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
