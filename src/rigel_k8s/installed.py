"""What other installed packages add to this one, by entry points.

They are looked up only for a name that this package does not have: reading the lists of all
installed packages takes longer than a small command.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from rigel_k8s.errors import UserError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: What a package can add: types of jobs and providers, commands of the command line, keys of an
#: orchestration job, and parts of its deploy.
Group: TypeAlias = Literal[
    "rigel_k8s.jobs",
    "rigel_k8s.providers",
    "rigel_k8s.commands",
    "rigel_k8s.options",
    "rigel_k8s.parts",
]
_WORDS: Mapping[Group, str] = {
    "rigel_k8s.jobs": "job type",
    "rigel_k8s.providers": "provider",
    "rigel_k8s.commands": "command",
    "rigel_k8s.options": "option",
    "rigel_k8s.parts": "part",
}


def list_entries(group: Group) -> tuple[EntryPoint, ...]:
    """Return all entry points of a group; importing nothing that they name."""
    return _read_entries(group, tuple(sys.path))


@functools.cache
def _read_entries(group: Group, search_path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Read the lists of all packages on the search path, once."""
    from importlib import metadata

    return tuple(metadata.entry_points(group=group))


def list_names(group: Group) -> set[str]:
    """Return the names that installed packages offer."""
    return {entry.name for entry in list_entries(group)}


def find(group: Group, name: str) -> Any:
    """Return what an installed package offers under a name; None if no package does.

    Raises:
        UserError: two packages offer it, or it cannot be imported.
    """
    entries = {entry.value: entry for entry in list_entries(group) if entry.name == name}
    if len(entries) > 1:
        raise UserError(
            f'two installed packages offer the {_WORDS[group]} "{name}":'
            f" {', '.join(sorted(entries))}",
            hint="uninstall one of them, or write the import path of the one you mean",
        )
    for entry in entries.values():
        try:
            return entry.load()
        except Exception as error:
            raise broken_error(_WORDS[group], name, error) from error
    return None


def broken_error(what: str, name: str, error: Exception) -> UserError:
    """Return the error about code of others that cannot be imported."""
    return UserError(
        f"cannot import {what} {name}: {type(error).__name__}: {error}",
        hint="import it in Python to see the whole traceback",
    )
