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
from rigel_k8s.jobs.matrix import combinations, split_limits
from rigel_k8s.rigelfile.model import (
    ComponentSpec,
    Concurrent,
    JobUse,
    Parallel,
    SequenceSpec,
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


def list_sequence_steps(sequence: SequenceSpec, find_job: Callable[[JobUse], Job]) -> Jobs:
    """Return what `run sequence` does.

    Args:
        find_job: returns a use of a job with its type.
    """

    def step(stage: Stage) -> Step:
        if isinstance(stage, Parallel):
            return Branches(stage.matrix, Jobs(tuple(map(step, stage.stages))))
        jobs = Jobs(tuple(map(find_job, stage.jobs)))
        if isinstance(stage, Concurrent):
            return Serving(tuple(map(find_job, stage.dependencies)), jobs)
        return jobs

    body = Jobs(tuple(map(step, sequence.stages)))
    return body if sequence.matrix is None else Jobs((Branches(sequence.matrix, body),))


def list_jobs(step: Step) -> Iterator[Job]:
    """Yield the jobs below a step in the order in which they start."""
    yield from (job for job, _ in list_uses(step, lambda step, known: None))


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
        for combination in combinations(split_limits(matrix(step, known) or {})[0]):
            yield from list_uses(step.body, matrix, {**known, **combination})
