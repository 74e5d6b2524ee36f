"""Reads parts of a Deployment that a user wrote, whatever their shape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


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
