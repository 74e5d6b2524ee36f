"""Jobs whose work is a function of the test, and a reporter that remembers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import attrs
import pytest

from rigel_k8s.jobs import engine
from rigel_k8s.jobs.job import JobContext, JobOptions
from rigel_k8s.jobs.steps import Branches, Job, Jobs
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile.model import ComponentSpec
from rigel_k8s.rigelfile.source import Span, YamlNode
from rigel_k8s.settings import Application, Settings
from tests.support.recorder import Recorder

HERE = Span(1, 1, 1, 1)
Work = Callable[[JobContext], None]


@attrs.define
class FunctionJob:
    """A job type whose work is a function; `alone` is what `exclusive` answers."""

    work: Work
    alone: Callable[[Mapping[str, Any]], str | None] | None = None
    options = dict

    def check(self, options: Any, application: Application) -> Sequence[Problem]:
        return ()

    def run(self, options: Any, job: JobContext) -> None:
        self.work(job)

    def exclusive(self, options: Any, application: Application, settings: Settings) -> str | None:
        return self.alone(options) if self.alone else None


def make_job(
    name: str, work: Work, *, alone: Callable[[Mapping[str, Any]], str | None] | None = None
) -> Job:
    spec = ComponentSpec(name, "test", YamlNode({}, HERE), ("jobs", name))
    return Job(spec, FunctionJob(work, alone))


def make_branches(matrix: Mapping[str, list[Any]], body: Any) -> Branches:
    """Branches whose matrix `around` reads as it is."""
    return Branches(YamlNode(dict(matrix), HERE), body)


@pytest.fixture
def told() -> Recorder:
    return Recorder()


class Reader:
    """A job's options are the data that it sees, and a matrix is what it is."""

    def realise(self, job: Job, data: Mapping[str, Any]) -> JobOptions:
        return JobOptions(dict(data), {})

    def matrix(self, step: Branches, data: Mapping[str, Any]) -> Mapping[str, list[Any]]:
        return step.matrix.value if step.matrix else {}


@attrs.frozen
class Around:
    """What a run needs beside its steps."""

    report: Any
    settings: Settings = attrs.field(factory=Settings)
    grace: float = 20


@pytest.fixture
def around(told: Recorder) -> Around:
    return Around(told)


def run_steps(
    steps: Jobs,
    around: Around,
    declared: Sequence[engine.Declared] = (),
    *,
    scope: CancelScope | None = None,
) -> dict[str, Any]:
    """Run steps, and return the data that the jobs stored."""
    data: dict[str, Any] = {}
    context = JobContext("", Application("noetic"), around.report, around.settings, data=data)
    engine.run_steps(steps, context, Reader(), declared, scope=scope, grace=around.grace)
    return data


class Meeting:
    """Proves that several threads are at one point at once: all must arrive, or it fails."""

    def __init__(self, parties: int) -> None:
        self._barrier = threading.Barrier(parties)

    def __call__(self) -> None:
        self._barrier.wait(timeout=20)
