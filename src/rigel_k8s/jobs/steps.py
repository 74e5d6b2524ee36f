"""What a sequence will do, as a tree of steps; built before anything runs, and pure.

Jobs        steps one after the other
Serving     dependencies that are started first and stopped when the jobs have ended
Branches    the same steps once for each combination of a matrix, side by side
Job         one use of a job
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import attrs

from rigel_k8s.jobs.job import JobType
from rigel_k8s.jobs.matrix import combinations
from rigel_k8s.jobs.waves import split_limits
from rigel_k8s.rigelfile.model import (
    ComponentSpec,
    Concurrent,
    JobUse,
    Parallel,
    SequenceSpec,
    Sequential,
    Stage,
)
from rigel_k8s.rigelfile.source import YamlNode


@attrs.frozen
class Job:
    """One use of a job: its `with`, overrides laid over it, and the type that runs it."""

    spec: ComponentSpec
    type: JobType[Any]
    overrides: YamlNode | None = None

    @property
    def name(self) -> str:
        """The job's key in the Rigelfile."""
        return self.spec.name


@attrs.frozen
class Jobs:
    """Steps one after the other."""

    steps: tuple[Step, ...]


@attrs.frozen
class Serving:
    """Jobs one after the other, while their dependencies serve them."""

    dependencies: tuple[Job, ...]
    jobs: Jobs


@attrs.frozen
class Branches:
    """A body run once for each combination, side by side; no matrix is one branch."""

    matrix: YamlNode | None
    body: Jobs


Step: TypeAlias = Job | Jobs | Serving | Branches
Types: TypeAlias = Mapping[str, JobType[Any]]


def list_job_steps(
    spec: ComponentSpec, kind: JobType[Any], overrides: YamlNode | None = None
) -> Jobs:
    """Return what `run job` does."""
    return Jobs((Job(spec, kind, overrides),))


def list_sequence_steps(
    sequence: SequenceSpec, specs: Mapping[str, ComponentSpec], types: Types
) -> Jobs:
    """Return what `run sequence` does, with the specs and types of its jobs by their keys."""

    def job(use: JobUse) -> Job:
        return Job(specs[use.name], types[use.name], use.overrides)

    def step(stage: Stage) -> Step:
        if isinstance(stage, Parallel):
            return Branches(stage.matrix, Jobs(tuple(step(inner) for inner in stage.stages)))
        listed = Jobs(tuple(job(use) for use in stage.jobs))
        if isinstance(stage, Sequential):
            return listed
        assert isinstance(stage, Concurrent)
        return Serving(tuple(job(use) for use in stage.dependencies), listed)

    body = Jobs(tuple(step(stage) for stage in sequence.stages))
    return body if sequence.matrix is None else Jobs((Branches(sequence.matrix, body),))


def list_jobs(step: Step) -> Iterator[Job]:
    """Yield the jobs below a step in the order in which they start."""
    if isinstance(step, Job):
        yield step
    elif isinstance(step, Jobs):
        for inner in step.steps:
            yield from list_jobs(inner)
    elif isinstance(step, Serving):
        yield from (*step.dependencies, *list_jobs(step.jobs))
    else:
        yield from list_jobs(step.body)


def list_uses(
    step: Step,
    matrix: Callable[[Branches, Mapping[str, Any]], Mapping[str, list[Any]] | None],
    known: Mapping[str, Any] | None = None,
) -> Iterator[tuple[Job, Mapping[str, Any]]]:
    """Yield the jobs below a step, once for each combination, with the values of that.

    Args:
        matrix: returns the values of a step's matrix, None if they are not known yet; such a
            step counts as one branch.
        known: the combination around the step.
    """
    known = known or {}
    if isinstance(step, Job):
        yield step, known
    elif isinstance(step, Jobs):
        for inner in step.steps:
            yield from list_uses(inner, matrix, known)
    elif isinstance(step, Serving):
        yield from ((job, known) for job in step.dependencies)
        yield from list_uses(step.jobs, matrix, known)
    else:
        values = split_limits(matrix(step, known) or {})[0]
        for combination in combinations(values):
            yield from list_uses(step.body, matrix, {**known, **combination})


def job_names(sequence: SequenceSpec) -> tuple[str, ...]:
    """Return the keys of the jobs that a sequence uses, each once."""
    return tuple(dict.fromkeys(use.name for use in sequence.list_uses()))
