"""How an option is declared: an attrs field that carries its own documentation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import attrs

T = TypeVar("T")


def option(
    doc: str,
    default: Any = None,
    *,
    accepts: Any = None,
    aliases: tuple[str, ...] = (),
    converter: Callable[[Any], Any] | None = None,
) -> Any:
    """Return a field with its documentation; each object gets its own mapping or list.

    Args:
        accepts: the type a user may write, if `converter` turns it into the field's own type.
        aliases: other keys that mean the same.
    """
    metadata = {"doc": doc, "aliases": aliases}
    if accepts is not None:
        metadata["accepts"] = accepts
    if isinstance(default, dict | list):
        return attrs.field(factory=type(default), metadata=metadata)
    return attrs.field(default=default, metadata=metadata, converter=converter)


def required_field(doc: str) -> Any:
    return attrs.field(metadata={"doc": doc})


def true_is_default(kind: type[T]) -> Callable[[bool | T], T | None]:
    """Return a converter of options that may be written as true: `kind` with all its defaults.

    False is None.
    """

    def convert(value: bool | T) -> T | None:  # noqa: FBT001 - as the Rigelfile has it
        if isinstance(value, kind):
            return value
        return kind() if value else None

    return convert
