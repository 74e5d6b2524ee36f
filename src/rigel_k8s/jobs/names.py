"""The names that resolve to job types and providers of this package; it imports none of them.

Job types above this package, such as Muto's agent, are installed with it and found by entry points.

Each has a short name, its name for users of Rigel (`rigel_k8s.OrchestrationPlugin`), and the names
of Rigel's own and of src.plugin that existing Rigelfiles use.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

import attrs

from rigel_k8s.installed import Group, list_entries

Kind: TypeAlias = Literal["job", "provider"]

GROUPS: Mapping[Kind, Group] = {"job": "rigel_k8s.jobs", "provider": "rigel_k8s.providers"}


@attrs.frozen
class Builtin:
    """A job type or provider that is named without its own import path.

    Attributes:
        short: its short name.
        target: module and class, `package.module:Class`; imported when it is needed.
        paths: the import paths that mean it.
    """

    short: str
    target: str
    paths: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Every name that a Rigelfile may use."""
        return (self.short, *self.paths)

    def load(self) -> type[Any]:
        """Import the class."""
        module, _, attribute = self.target.partition(":")
        found: type[Any] = getattr(importlib.import_module(module), attribute)
        return found


_TYPES = "rigel_k8s.jobs.types"

BUILTIN: Mapping[Kind, tuple[Builtin, ...]] = {
    "job": (
        Builtin(
            "orchestration",
            f"{_TYPES}.orchestration:OrchestrationJob",
            ("rigel_k8s.OrchestrationPlugin", "src.plugin.OrchestrationPlugin"),
        ),
    ),
    "provider": (
        Builtin(
            "registry",
            f"{_TYPES}.container_registry:ContainerRegistry",
            (
                "rigel_k8s.ContainerRegistryProvider",
                "rigel.providers.core.ContainerRegistryProvider",
            ),
        ),
    ),
}


def index_by_name(kind: Kind) -> dict[str, Builtin]:
    """Return this package's job types or providers under each of their names."""
    return {name: builtin for builtin in BUILTIN[kind] for name in builtin.names}


def list_installed(kind: Kind) -> tuple[Builtin, ...]:
    """Return what entry points offer; a name with a dot means the same as the short one."""
    targets: dict[str, list[str]] = {}
    for entry in list_entries(GROUPS[kind]):
        targets.setdefault(entry.value, []).append(entry.name)
    found = []
    for target, names in targets.items():
        short, *paths = sorted(names, key=lambda name: "." in name)
        found.append(Builtin(short, target, tuple(paths)))
    return tuple(found)
