"""The grammar as a file has it: its keys and values; model.py is built from it."""

# ruff: noqa: RUF009 - `_key` is attrs.field with the documentation in front

from __future__ import annotations

from typing import Any, ClassVar, TypeAlias

import attrs

from rigel_k8s.rigelfile.source import YamlNode


def _key(doc: str, **arguments: Any) -> Any:
    """Return a field with its documentation; `key` is its name in the file if it differs."""
    metadata = {"doc": doc}
    if "key" in arguments:
        metadata["key"] = arguments.pop("key")
    return attrs.field(metadata=metadata, **arguments)


@attrs.frozen(kw_only=True)
class ApplicationForm:
    """What is built and deployed."""

    distro: str = _key("the ROS distribution: noetic, humble ...")
    dir: str = _key("the sources, relative to the Rigelfile", default=".")


@attrs.frozen(kw_only=True)
class JobForm:
    """A job: a plugin and its options."""

    plugin: str = _key("a job type: rigel_k8s.OrchestrationPlugin, a short name, an import path")
    options: YamlNode | None = _key("the plugin's options", key="with", default=None)


@attrs.frozen(kw_only=True)
class ProviderForm:
    """A provider: connected before a sequence runs, disconnected after it."""

    provider: str = _key("a provider: rigel_k8s.ContainerRegistryProvider, an import path")
    options: YamlNode | None = _key("the provider's options", key="with", default=None)


@attrs.frozen(kw_only=True)
class JobUseForm:
    """A job with other options than its own."""

    expects: ClassVar[str] = "{name: JOB, with: {...}}"

    name: str = _key("the job's name")
    options: YamlNode | None = _key("keys that replace the job's own", key="with", default=None)


_Use: TypeAlias = str | JobUseForm
_STAGE = "a stage such as {jobs: [a, b]}"


@attrs.frozen(kw_only=True)
class SequentialForm:
    """Jobs one after the other."""

    expects: ClassVar[str] = _STAGE

    jobs: list[_Use] = _key("jobs to run one after the other")
    description: str = _key("a comment", default="")


@attrs.frozen(kw_only=True)
class ConcurrentForm:
    """Jobs, and others that serve them meanwhile."""

    expects: ClassVar[str] = _STAGE

    jobs: list[_Use] = _key("jobs to run one after the other")
    dependencies: list[_Use] = _key("jobs started first, and stopped when `jobs` have ended")
    description: str = _key("a comment", default="")


@attrs.frozen(kw_only=True)
class ParallelForm:
    """Stages run once for each combination of a matrix, side by side."""

    expects: ClassVar[str] = _STAGE

    parallel: list[SequentialForm | ConcurrentForm] = _key("the stages of each branch")
    matrix: YamlNode | None = _key("lists of values: one branch for each combination", default=None)
    description: str = _key("a comment", default="")


@attrs.frozen(kw_only=True)
class SequenceForm:
    """Stages one after the other."""

    stages: list[SequentialForm | ConcurrentForm | ParallelForm] = _key("what runs, in this order")
    matrix: YamlNode | None = _key("lists of values: all stages once for each", default=None)
    description: str = _key("a comment", default="")


@attrs.frozen(kw_only=True)
class RigelfileForm:
    """A whole Rigelfile; its sections stay Nodes, because each is checked separately."""

    application: YamlNode = _key("what is built and deployed")
    vars: YamlNode | None = _key("values for {{ vars.NAME }}", default=None)
    jobs: YamlNode | None = _key("what can be done, by name", default=None)
    providers: YamlNode | None = _key("what jobs may be connected to, by name", default=None)
    sequences: YamlNode | None = _key("which jobs run in which order, by name", default=None)
