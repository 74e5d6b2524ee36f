"""The names that Rigelfiles use: for Rigel they are subclasses of its own, otherwise ours."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import cache
from typing import Any

from rigel_k8s.compat.plugin import ConnectionProvider, JobPlugin
from rigel_k8s.jobs.names import Builtin, Kind, index_by_name, list_installed

BASES: Mapping[Kind, tuple[str, str]] = {
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
    for kind, (module, attribute) in BASES.items():
        installed = (one for one in list_installed(kind) if path in one.paths)
        builtin = index_by_name(kind).get(path) or next(installed, None)
        if builtin:
            base = getattr(sys.modules.get(module), attribute, None)
            return _adapt(kind, name, builtin, base) if base else builtin.load()
    raise AttributeError(f"module 'rigel_k8s' has no attribute {name!r}")


@cache
def _adapt(kind: Kind, name: str, builtin: Builtin, base: type[Any]) -> type[Any]:
    adapter = JobPlugin if kind == "job" else ConnectionProvider
    members = {"builtin": builtin, "__module__": "rigel_k8s", "__doc__": adapter.__doc__}
    return type(name, (adapter, base), members)
