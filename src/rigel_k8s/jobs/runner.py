"""`run job` and `run sequence`: resolve and check everything, then run it.

Job types decide what a job does, engine.py decides how a run proceeds.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, TypeVar

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.jobs.engine import Declared, run_steps
from rigel_k8s.jobs.importing import importable
from rigel_k8s.jobs.job import JobContext, JobReporter, JobType
from rigel_k8s.jobs.names import Kind, index_by_name
from rigel_k8s.jobs.registry import resolve
from rigel_k8s.jobs.steps import Job, Jobs, list_jobs, list_sequence_steps
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.jobs.values import Values, check_steps
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import (
    Finding,
    Rigelfile,
    find_type,
    name_nearest,
    place,
    preview,
    problems_error,
    realise,
    render,
)
from rigel_k8s.rigelfile.model import ComponentSpec, JobUse, SequenceSpec
from rigel_k8s.rigelfile.spending import TooLarge
from rigel_k8s.settings import Application, Settings

T = TypeVar("T")


@attrs.frozen
class Prepared:
    """What will run, and what its check has found."""

    rigelfile: Rigelfile
    settings: Settings
    steps: Jobs
    values: Values
    providers: tuple[Declared, ...]
    findings: Sequence[Finding]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the check found, rendered, without the word "warning"."""
        source = self.rigelfile.source
        return tuple(render(source, finding, marked=False) for finding in self.findings)


def find_cluster_job(prepared: Prepared) -> str | None:
    """Return the first job that needs the cluster, which must be configured before the run.

    None: no job needs one, or a job or provider before it may create the cluster.
    """
    before: list[object] = [declared.type for declared in prepared.providers]
    for job in list_jobs(prepared.steps):
        if getattr(job.type, "needs_cluster", False):
            known = all(getattr(kind, "needs_cluster", None) is False for kind in before)
            return job.name if known else None
        before.append(job.type)
    return None


def prepare_job(rigelfile: Rigelfile, name: str, settings: Settings) -> Prepared:
    """Resolve and check one job.

    Raises:
        ProblemsError: all that is wrong with it and with the providers.
        UserError: unknown job.
    """
    _find_named("job", name, rigelfile.jobs)
    return _refuse_errors(_prepare(rigelfile, settings, JobUse(name)))


def prepare_sequence(rigelfile: Rigelfile, name: str, settings: Settings) -> Prepared:
    """Resolve and check a sequence, each combination of a matrix that is known.

    Raises:
        ProblemsError: all that is wrong with its jobs and with the providers.
        UserError: unknown sequence, or two of its jobs cannot run side by side.
    """
    sequence = _find_named("sequence", name, rigelfile.sequences)
    return _refuse_errors(_prepare(rigelfile, settings, sequence))


def prepare_use(rigelfile: Rigelfile, use: JobUse, settings: Settings) -> Prepared:
    """Resolve and check one use of a job, for a runner that connects other people's providers.

    Raises:
        ProblemsError: all that is wrong with it and with the providers of this package.
    """
    ours = {n: p for n, p in rigelfile.providers.items() if p.plugin in index_by_name("provider")}
    return _refuse_errors(_prepare(attrs.evolve(rigelfile, providers=ours), settings, use))


def list_steps(rigelfile: Rigelfile, name: str, settings: Settings) -> Jobs:
    """Return the steps of a sequence without checking its jobs.

    Raises:
        UserError: unknown sequence.
    """
    sequence = _find_named("sequence", name, rigelfile.sequences)
    return list_sequence_steps(sequence, _Resolution(rigelfile, settings).job)


def check_sequence(rigelfile: Rigelfile, name: str, settings: Settings) -> Sequence[Finding]:
    """Return the errors and warnings of prepare_sequence, each with its place."""
    try:
        return _prepare(rigelfile, settings, rigelfile.sequences[name]).findings
    except TooLarge as error:
        return [error.finding]
    except UserError as error:  # two of its jobs cannot run side by side
        message = "; ".join(filter(None, (error.message, error.hint)))
        problem = Problem(("sequences", name), message, "side-by-side", at_key=True)
        return [place(rigelfile.root, problem)]


def run(
    prepared: Prepared,
    report: JobReporter,
    *,
    data: dict[str, Any] | None = None,
    connected: Mapping[str, Any] | None = None,
    scope: CancelScope | None = None,
    applied: threading.Event | None = None,
) -> Mapping[str, Any]:
    """Run what was prepared; return the data that the jobs stored. It reports no warnings.

    Args:
        prepared: what prepare_job or prepare_sequence returned.
        report: takes what is printed.
        data: what was stored before; jobs write into it.
        connected: connections that the caller has made for providers.
        scope: what stops the run from outside.
        applied: set when a job that deploys has stored its objects.

    Raises:
        JobFailed: a job failed; the error names it.
        Interrupted: Ctrl-C or SIGTERM.
    """
    declared = [d for d in prepared.providers if d.name not in (connected or {})]
    context = JobContext(
        name="",
        application=prepared.rigelfile.application,
        report=report,
        settings=prepared.settings,
        data={} if data is None else data,
        vars=prepared.rigelfile.vars,
        providers=connected or {},
        applied=applied or threading.Event(),
    )
    with importable(prepared.settings.rigelfile.parent):
        run_steps(prepared.steps, context, prepared.values, declared, scope=scope)
    return context.data


def warn_and_run(prepared: Prepared, report: JobReporter) -> Mapping[str, Any]:
    """Report the warnings, then run what was prepared; raises as run."""
    for warning in prepared.warnings:
        report.warn(warning)
    return run(prepared, report)


def _prepare(rigelfile: Rigelfile, settings: Settings, what: JobUse | SequenceSpec) -> Prepared:
    """Resolve and check a job or a sequence; errors are among the findings."""
    resolution = _Resolution(rigelfile, settings)
    if isinstance(what, JobUse):
        steps = Jobs((resolution.job(what),))
    else:
        steps = list_sequence_steps(what, resolution.job)
    providers = tuple(filter(None, map(resolution.provider, rigelfile.providers.values())))
    values = Values(rigelfile)
    with importable(settings.rigelfile.parent):
        findings = [*resolution.findings, *check_steps(steps, rigelfile, values, settings)]
    return Prepared(rigelfile, settings, steps, values, providers, findings)


def _refuse_errors(prepared: Prepared) -> Prepared:
    """Return what can run. Raises ProblemsError if something is wrong with it."""
    if any(finding.severity == "error" for finding in prepared.findings):
        raise problems_error(prepared.rigelfile.source, prepared.findings)
    return prepared


class _Unresolved:
    """Replaces a job type that could not be resolved, so that the other jobs are checked too."""

    options: ClassVar[type[Any]] = dict

    def check(self, options: Any, application: Application) -> tuple[()]:
        return ()

    def run(self, options: Any, job: JobContext) -> None:
        raise AssertionError("a sequence with an unresolved job type is never run")


class _Resolution:
    """Turns components into types and options, and notes what is wrong."""

    def __init__(self, rigelfile: Rigelfile, settings: Settings) -> None:
        self.findings: list[Finding] = []
        self._rigelfile = rigelfile
        self._directory = settings.rigelfile.parent
        self._types: dict[str, JobType[Any]] = {}

    def job(self, use: JobUse) -> Job:
        spec = self._rigelfile.jobs[use.name]
        if use.name not in self._types:
            self._types[use.name] = self._find_type("job", spec) or _Unresolved()
        return Job(spec, self._types[use.name], use.overrides)

    def provider(self, spec: ComponentSpec) -> Declared | None:
        kind = self._find_type("provider", spec)
        if kind is None:
            return None
        seen = preview(self._rigelfile, spec, None, {}, kind.options)
        self.findings += seen.findings
        if seen.findings:
            return None
        options = realise(self._rigelfile, spec, None, {}, kind.options).options
        self.findings += seen.check(kind, self._rigelfile.application, self._rigelfile.jobs)
        return Declared(spec.name, kind, options)

    def _find_type(self, kind: Kind, spec: ComponentSpec) -> Any | None:
        found = find_type(self._rigelfile.root, kind, spec, partial(resolve, self._directory))
        if isinstance(found, Finding):
            self.findings.append(found)
            return None
        return found


def _find_named(what: str, name: str, known: Mapping[str, T]) -> T:
    if name in known:
        return known[name]
    raise UserError(
        f'unknown {what} "{name}"{name_nearest(name, known)}',
        hint=f"its {what}s are {', '.join(known)}" if known else f"it has no {what}s",
    )
