"""Reads parts of objects that a user wrote or may have changed, whatever their shape."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

T = TypeVar("T")


def parse_json(text: str | None, otherwise: T) -> T:
    """Return an annotation's JSON as data; `otherwise` if it is invalid, or of another type."""
    try:
        found = json.loads(text or "")
    except (ValueError, RecursionError):
        return otherwise
    return found if isinstance(found, type(otherwise)) else otherwise


def mapping(value: Any) -> Mapping[str, Any]:
    """Return a mapping; an empty one for anything else."""
    return value if isinstance(value, Mapping) else {}


def list_mappings(value: Any) -> Iterator[Mapping[str, Any]]:
    """Yield the mappings of a list."""
    items = value if isinstance(value, list | tuple) else ()
    yield from (one for one in items if isinstance(one, Mapping))


def pod_of(tree: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the spec of the pods of a part of a Deployment."""
    return mapping(mapping(mapping(tree.get("spec")).get("template")).get("spec"))


def containers_of(tree: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the containers of a part of a Deployment."""
    return list(list_mappings(pod_of(tree).get("containers")))
