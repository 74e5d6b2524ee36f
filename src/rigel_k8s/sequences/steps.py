"""What a sequence will do, as a tree of steps; made before anything runs, and pure.

Jobs        steps one after the other
Serving     dependencies that are started first and stopped when the jobs have ended
Branches    the same steps once for each combination of a matrix, side by side
Job         one use of a job
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import attrs

from rigel_k8s.rigelfile.model import (
    ComponentSpec,
    Concurrent,
    JobUse,
    Parallel,
    SequenceSpec,
    Sequential,
    Stage,
)
from rigel_k8s.rigelfile.source import Node
from rigel_k8s.sequences.job import JobType

__all__ = ["Branches", "Job", "Jobs", "Serving", "Step", "each_job", "of_job", "of_sequence"]


@attrs.frozen
class Job:
    """One use of a job: its `with`, overrides laid over it, and the type that runs it."""

    spec: ComponentSpec
    type: JobType[Any]
    overrides: Node | None = None

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

    matrix: Node | None
    body: Jobs


Step: TypeAlias = Job | Jobs | Serving | Branches
Types: TypeAlias = Mapping[str, JobType[Any]]


def of_job(spec: ComponentSpec, kind: JobType[Any]) -> Jobs:
    """Return what `run job` does."""
    return Jobs((Job(spec, kind),))


def of_sequence(
    sequence: SequenceSpec,
    jobs: Mapping[str, ComponentSpec],
    kind_of: Callable[[str], JobType[Any]],
) -> Jobs:
    """Return what `run sequence` does; `kind_of` gives the type of a job's key."""

    def job(use: JobUse) -> Job:
        return Job(jobs[use.name], kind_of(use.name), use.overrides)

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


def each_job(step: Step) -> Iterator[Job]:
    """Yield every use of a job under a step."""
    if isinstance(step, Job):
        yield step
    elif isinstance(step, Jobs):
        for inner in step.steps:
            yield from each_job(inner)
    elif isinstance(step, Serving):
        yield from step.dependencies
        yield from each_job(step.jobs)
    else:
        yield from each_job(step.body)
