"""The combinations of a matrix's values, in the order they are written."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any


def combinations(matrix: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Return the combinations; no key gives the one empty combination, an empty list gives none."""
    return [
        dict(zip(matrix, choice, strict=True)) for choice in itertools.product(*matrix.values())
    ]


def label(combination: Mapping[str, Any]) -> str:
    """Return a branch's name: `distro=noetic, arch=arm64`."""
    return ", ".join(f"{key}={value}" for key, value in combination.items())
