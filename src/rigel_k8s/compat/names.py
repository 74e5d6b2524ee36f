"""The names that Rigelfiles use: for Rigel they are subclasses of its own, otherwise ours."""

from __future__ import annotations

import importlib
import sys
from functools import cache
from typing import Any

from rigel_k8s.compat.plugin import JobPlugin
from rigel_k8s.compat.provider import ConnectionProvider
from rigel_k8s.jobs.names import Builtin, Kind, index_by_name, list_installed

BASES = {
    "job": ("rigel.plugins.plugin", "Plugin"),
    "provider": ("rigel.providers.provider", "Provider"),
}


def public(name: str) -> Any:
    """Return what `rigel_k8s.NAME` is: `OrchestrationPlugin`, `ContainerRegistryProvider` ...

    A subclass of Rigel's Plugin if Rigel has been imported already (it loads nothing else), and
    otherwise the job type.

    Raises:
        AttributeError: the name does not exist.
    """
    path = f"rigel_k8s.{name}"
    for kind in ("job", "provider"):
        builtin = index_by_name(kind).get(path) or _find_installed(kind, path)
        if builtin:
            return _adapt_to_rigel(kind, name, builtin) or _load_builtin(builtin)
    raise AttributeError(f"module 'rigel_k8s' has no attribute {name!r}")


def _find_installed(kind: Kind, path: str) -> Builtin | None:
    return next((one for one in list_installed(kind) if path in one.paths), None)


def _load_builtin(builtin: Builtin) -> Any:
    module, _, attribute = builtin.target.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _adapt_to_rigel(kind: Kind, name: str, builtin: Builtin) -> type[Any] | None:
    module, attribute = BASES[kind]
    base = getattr(sys.modules.get(module), attribute, None)
    return _adapter(kind, name, builtin, base) if base else None


@cache
def _adapter(kind: Kind, name: str, builtin: Builtin, base: type[Any]) -> type[Any]:
    adapter = JobPlugin if kind == "job" else ConnectionProvider
    members = {"builtin": builtin, "__module__": "rigel_k8s", "__doc__": adapter.__doc__}
    return type(name, (adapter, base), members)
