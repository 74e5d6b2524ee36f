"""Values that are imported on their first use, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Generic, TypeVar

import attrs

T = TypeVar("T")


@attrs.frozen
class Lazily(Mapping[str, T], Generic[T]):
    """A mapping of names to values of modules.

    Attributes:
        homes: by name: the module and the value's name in it, MODULE:NAME.
    """

    homes: Mapping[str, str]

    def __getitem__(self, name: str) -> T:
        """Import a value."""
        module, _, attribute = self.homes[name].partition(":")
        value: T = getattr(import_module(module), attribute)
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self.homes)

    def __len__(self) -> int:
        return len(self.homes)
