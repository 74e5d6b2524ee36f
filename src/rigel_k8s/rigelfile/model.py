"""The Rigelfile as data: Rigel 0.3's grammar, where every part has its place in the text.

The classes with documented keys are the grammar: a file is structured into them, and the JSON
schema is made from them. A job's `with` stays a Node until a job type reads its options.
"""

# ruff: noqa: RUF009 - `_key` is attrs.field with the documentation in front

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, ClassVar, TypeAlias

import attrs

from rigel_k8s.problems import Path
from rigel_k8s.rigelfile.scope import Scope
from rigel_k8s.rigelfile.source import Source, YamlNode, strip_places
from rigel_k8s.settings import Application

#: Keys of a matrix that are limits, each a list of one number, and no values of its branches.
MAX_PARALLEL, STOP_AFTER = "max_parallel", "stop_after_failures"
LIMITS = (MAX_PARALLEL, STOP_AFTER)

_STAGE = "a stage such as {jobs: [a, b]}"


def _key(doc: str, *, key: str | None = None, accepts: Any = None, **arguments: Any) -> Any:
    """Return a field with its documentation.

    Args:
        doc: what it is for.
        key: its name in the file, if that differs.
        accepts: what a user may write, if a converter makes another type of it.
        arguments: those of attrs.field.
    """
    metadata = {"doc": doc, "key": key, "accepts": accepts}
    return attrs.field(metadata={k: v for k, v in metadata.items() if v}, **arguments)


@attrs.frozen(kw_only=True)
class ApplicationEntry:
    """What is built and deployed."""

    distro: str = _key("the ROS distribution: noetic, humble ...")
    dir: str = _key("the sources, relative to the Rigelfile", default=".")


@attrs.frozen(kw_only=True)
class JobEntry:
    """A job: a plugin and its options."""

    plugin: str = _key("a job type: rigel_k8s.OrchestrationPlugin, a short name, an import path")
    options: YamlNode | None = _key("the plugin's options", key="with", default=None)


@attrs.frozen(kw_only=True)
class ProviderEntry:
    """A provider: connected before a sequence runs, disconnected after it."""

    plugin: str = _key(
        "a provider: rigel_k8s.ContainerRegistryProvider, an import path", key="provider"
    )
    options: YamlNode | None = _key("the provider's options", key="with", default=None)


@attrs.frozen
class JobUse:
    """A job with other options than its own."""

    expects: ClassVar[str] = "{name: JOB, with: {...}}"

    name: str = _key("the job's name")
    overrides: YamlNode | None = _key("keys that replace the job's own", key="with", default=None)


def _uses(entries: Iterable[str | JobUse]) -> tuple[JobUse, ...]:
    return tuple(use if isinstance(use, JobUse) else JobUse(use) for use in entries)


_Uses: TypeAlias = list[str | JobUse]


@attrs.frozen(kw_only=True)
class Sequential:
    """Jobs one after the other."""

    expects: ClassVar[str] = _STAGE

    jobs: tuple[JobUse, ...] = _key(
        "jobs to run one after the other", accepts=_Uses, converter=_uses
    )
    description: str = _key("a comment", default="")


@attrs.frozen(kw_only=True)
class Concurrent(Sequential):
    """Jobs, and others that serve them meanwhile."""

    dependencies: tuple[JobUse, ...] = _key(
        "jobs started first, and stopped when `jobs` have ended", accepts=_Uses, converter=_uses
    )


@attrs.frozen(kw_only=True)
class Parallel:
    """Stages run once for each combination of a matrix, side by side."""

    expects: ClassVar[str] = _STAGE

    stages: list[Sequential | Concurrent] = _key("the stages of each branch", key="parallel")
    matrix: YamlNode | None = _key("lists of values: one branch for each combination", default=None)
    description: str = _key("a comment", default="")


Stage: TypeAlias = Sequential | Concurrent | Parallel


@attrs.frozen(kw_only=True)
class SequenceSpec:
    """Stages one after the other."""

    stages: list[Stage] = _key("what runs, in this order")
    matrix: YamlNode | None = _key("lists of values: all stages once for each", default=None)
    description: str = _key("a comment", default="")

    def list_uses(self) -> Iterator[JobUse]:
        """Yield each entry of the stages' jobs and dependencies."""
        for stage in self.stages:
            for inner in stage.stages if isinstance(stage, Parallel) else (stage,):
                yield from inner.dependencies if isinstance(inner, Concurrent) else ()
                yield from inner.jobs


@attrs.frozen(kw_only=True)
class Sections:
    """A whole Rigelfile; its sections stay Nodes, because each is checked separately."""

    application: YamlNode = _key("what is built and deployed")
    vars: YamlNode | None = _key("values for {{ vars.NAME }}", default=None)
    jobs: YamlNode | None = _key("what can be done, by name", default=None)
    providers: YamlNode | None = _key("what jobs may be connected to, by name", default=None)
    sequences: YamlNode | None = _key("which jobs run in which order, by name", default=None)


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
