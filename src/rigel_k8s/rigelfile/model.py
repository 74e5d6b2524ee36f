"""The Rigelfile as data: Rigel 0.3's grammar, where every part has its place in the text.

It is independent of plugins: a job's `with` stays a Node until a job type reads its options.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import attrs

from rigel_k8s.problems import Path
from rigel_k8s.rigelfile.scope import Scope
from rigel_k8s.rigelfile.source import Source, YamlNode, strip_places
from rigel_k8s.settings import Application

#: Keys of a matrix that are limits, each a list of one number, and no values of its branches.
MAX_PARALLEL, STOP_AFTER = "max_parallel", "stop_after_failures"
LIMITS = (MAX_PARALLEL, STOP_AFTER)


@attrs.frozen
class ComponentSpec:
    """A job or a provider: `jobs.NAME` or `providers.NAME`.

    Attributes:
        plugin: the import path or short name as written.
        options: the `with` mapping; vars are substituted, `{{ data.x }}` is still a hole.
        path: where the component stands (`("jobs", "deploy")`).
    """

    name: str
    plugin: str
    options: YamlNode
    path: Path


@attrs.frozen
class JobUse:
    """One entry of a stage's jobs: a name, and optionally a `with` that overrides keys."""

    name: str
    overrides: YamlNode | None = None
    path: Path = ()


@attrs.frozen
class Sequential:
    """Jobs one after the other."""

    jobs: tuple[JobUse, ...]
    description: str | None = None


@attrs.frozen
class Concurrent:
    """Jobs in turn, beside dependencies that are started first and stopped when they have ended."""

    jobs: tuple[JobUse, ...]
    dependencies: tuple[JobUse, ...] = ()
    description: str | None = None


@attrs.frozen
class Parallel:
    """Inner stages once for each combination of the matrix, in parallel, each with own data."""

    stages: tuple[Sequential | Concurrent, ...]
    matrix: YamlNode | None = None
    description: str | None = None


Stage: TypeAlias = Sequential | Concurrent | Parallel


@attrs.frozen
class SequenceSpec:
    """`sequences.NAME`; its own matrix runs all stages once for each combination."""

    name: str
    stages: tuple[Stage, ...]
    matrix: YamlNode | None = None
    description: str | None = None


@attrs.frozen
class Rigelfile:
    """A whole Rigelfile, checked against the grammar, vars substituted.

    `scope` fills in templates that wait for data.
    """

    source: Source
    root: YamlNode
    application: Application
    jobs: Mapping[str, ComponentSpec]
    providers: Mapping[str, ComponentSpec]
    sequences: Mapping[str, SequenceSpec]
    scope: Scope

    @property
    def vars(self) -> dict[str, Any]:
        """`vars` as plain data, templates filled as far as they can be without data."""
        section = self.root.value.get("vars")
        return (strip_places(section) if section else None) or {}
