"""How an object is named, as plain data; no I/O here, so that every package may use it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import attrs

Manifest: TypeAlias = Mapping[str, Any]


@attrs.frozen(order=True)
class ObjectRef:
    """Names one object; namespace is "" for cluster-wide kinds."""

    api_version: str
    kind: str
    namespace: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.namespace}/{self.name}".replace(" /", " ")


def ref_of(manifest: Manifest) -> ObjectRef:
    """Return the reference of a manifest or live object; some, such as a review, have no name."""
    meta = manifest["metadata"]
    return ObjectRef(
        manifest["apiVersion"], manifest["kind"], meta.get("namespace", ""), meta.get("name", "")
    )
