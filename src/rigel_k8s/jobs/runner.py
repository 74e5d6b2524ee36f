"""`run job` and `run sequence`: resolve and check everything, then run it.

Job types decide what a job does, live.py decides how a run proceeds.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.jobs.checking import JobPreview
from rigel_k8s.jobs.execution import RunContext
from rigel_k8s.jobs.importing import importable
from rigel_k8s.jobs.job import JobContext, JobReporter, JobType
from rigel_k8s.jobs.live import run_steps
from rigel_k8s.jobs.names import index_by_name
from rigel_k8s.jobs.providers import Declared
from rigel_k8s.jobs.registry import job_type, provider_type
from rigel_k8s.jobs.scope import CancelScope
from rigel_k8s.jobs.steps import (
    Jobs,
    job_names,
    list_job_steps,
    list_jobs,
    list_sequence_steps,
)
from rigel_k8s.jobs.values import Values
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import (
    Finding,
    Rigelfile,
    YamlNode,
    find_nearest,
    place,
    preview,
    problems_error,
    realise,
    render,
)
from rigel_k8s.rigelfile.model import ComponentSpec
from rigel_k8s.rigelfile.spending import TooLarge
from rigel_k8s.settings import Application, Settings
from rigel_k8s.system.trust import Untrusted

T = TypeVar("T")

#: Seconds that jobs may take to end after Ctrl-C or another job's failure.
GRACE = 30.0


@attrs.frozen
class Prepared:
    """What will run, checked; `warnings` are rendered, without the word "warning"."""

    rigelfile: Rigelfile
    settings: Settings
    steps: Jobs
    values: Values
    providers: tuple[Declared, ...]
    warnings: tuple[str, ...]


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
    spec = _find_named("job", name, rigelfile.jobs)
    return _check_steps(
        rigelfile, settings, [name], lambda types: list_job_steps(spec, types[name])
    ).prepare()


def prepare_sequence(rigelfile: Rigelfile, name: str, settings: Settings) -> Prepared:
    """Resolve and check a sequence, each combination of a matrix that is known.

    Raises:
        ProblemsError: all that is wrong with its jobs and with the providers.
        UserError: unknown sequence, or two of its jobs cannot run side by side.
    """
    return _check_sequence(rigelfile, name, settings).prepare()


def list_steps(rigelfile: Rigelfile, name: str, settings: Settings) -> Jobs:
    """Return the steps of a sequence without checking its jobs.

    Raises:
        UserError: unknown sequence.
    """
    sequence = _find_named("sequence", name, rigelfile.sequences)
    resolved = _Resolution(rigelfile, settings.rigelfile.parent, [])
    types = {job: resolved.job(rigelfile.jobs[job]) for job in job_names(sequence)}
    return list_sequence_steps(sequence, rigelfile.jobs, types)


def check_sequence(rigelfile: Rigelfile, name: str, settings: Settings) -> Sequence[Finding]:
    """Return the errors and warnings of prepare_sequence, each with its place."""
    try:
        return _check_sequence(rigelfile, name, settings).findings
    except TooLarge as error:
        return [error.finding]
    except UserError as error:  # two of its jobs cannot run side by side
        message = "; ".join(filter(None, (error.message, error.hint)))
        problem = Problem(("sequences", name), message, "side-by-side", at_key=True)
        return [place(rigelfile.root, problem)]


def prepare_use(
    rigelfile: Rigelfile, spec: ComponentSpec, overrides: YamlNode | None, settings: Settings
) -> Prepared:
    """Resolve and check one use of a job, for a runner that connects other people's providers.

    Raises:
        ProblemsError: all that is wrong with it and with the providers of this package.
    """
    ours = {n: p for n, p in rigelfile.providers.items() if p.plugin in index_by_name("provider")}
    rigelfile = attrs.evolve(rigelfile, providers=ours)
    return _check_steps(
        rigelfile,
        settings,
        [spec.name],
        lambda types: list_job_steps(spec, types[spec.name], overrides),
    ).prepare()


def run(
    prepared: Prepared,
    report: JobReporter,
    *,
    data: dict[str, Any] | None = None,
    connected: Mapping[str, Any] | None = None,
    scope: CancelScope | None = None,
    applied: threading.Event | None = None,
) -> dict[str, Any]:
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
    context = RunContext(
        application=prepared.rigelfile.application,
        settings=prepared.settings,
        report=report,
        realise=prepared.values.realise,
        matrix=prepared.values.matrix,
        vars=prepared.rigelfile.vars,
        providers=connected or {},
        grace=GRACE,
        applied=applied or threading.Event(),
    )
    with importable(prepared.settings.rigelfile.parent):
        return run_steps(prepared.steps, context, declared, data=data, scope=scope)


def warn_and_run(prepared: Prepared, report: JobReporter) -> dict[str, Any]:
    """Report the warnings, then run what was prepared; raises as run."""
    for warning in prepared.warnings:
        report.warn(warning)
    return run(prepared, report)


@attrs.frozen
class _CheckedSteps:
    """Steps with the findings about them."""

    rigelfile: Rigelfile
    settings: Settings
    steps: Jobs
    values: Values
    providers: tuple[Declared, ...]
    findings: Sequence[Finding]

    def prepare(self) -> Prepared:
        """Return what can run; raise ProblemsError if something is wrong."""
        source = self.rigelfile.source
        if any(finding.severity == "error" for finding in self.findings):
            raise problems_error(source, self.findings)
        warnings = tuple(render(source, found, marked=False) for found in self.findings)
        return Prepared(
            self.rigelfile, self.settings, self.steps, self.values, self.providers, warnings
        )


def _check_sequence(rigelfile: Rigelfile, name: str, settings: Settings) -> _CheckedSteps:
    sequence = _find_named("sequence", name, rigelfile.sequences)

    def steps(types: Mapping[str, JobType[Any]]) -> Jobs:
        return list_sequence_steps(sequence, rigelfile.jobs, types)

    return _check_steps(rigelfile, settings, job_names(sequence), steps)


def _check_steps(
    rigelfile: Rigelfile,
    settings: Settings,
    names: Iterable[str],
    steps_of: Callable[[Mapping[str, JobType[Any]]], Jobs],
) -> _CheckedSteps:
    findings: list[Finding] = []
    resolved = _Resolution(rigelfile, settings.rigelfile.parent, findings)
    steps = steps_of({name: resolved.job(rigelfile.jobs[name]) for name in names})
    declared = [resolved.provider(spec) for spec in rigelfile.providers.values()]
    values = Values(rigelfile)
    preview = JobPreview(values.preview, values.preview_matrix, rigelfile.application, settings)
    with importable(settings.rigelfile.parent):
        findings += preview.check(steps)
    providers = tuple(filter(None, declared))
    return _CheckedSteps(rigelfile, settings, steps, values, providers, findings)


class _Unresolved:
    """Replaces a job type that could not be resolved, so that the other jobs are checked too."""

    options: ClassVar[type[Any]] = dict

    def check(self, options: Any, application: Application) -> tuple[()]:
        return ()

    def run(self, options: Any, job: JobContext) -> None:
        raise AssertionError("a sequence with an unresolved job type is never run")


@attrs.frozen
class _Resolution:
    """Turns components into types and options, and notes what is wrong."""

    rigelfile: Rigelfile
    directory: Path
    findings: list[Finding]

    def job(self, spec: ComponentSpec) -> JobType[Any]:
        return self._resolve(spec, "plugin", job_type) or _Unresolved()

    def provider(self, spec: ComponentSpec) -> Declared | None:
        kind = self._resolve(spec, "provider", provider_type)
        if kind is None:
            return None
        seen = preview(self.rigelfile, spec, None, {}, kind.options)
        self.findings.extend(seen.findings)
        if seen.findings:
            return None
        options = realise(self.rigelfile, spec, None, {}, kind.options).options
        problems = kind.check(options, self.rigelfile.application)
        self.findings.extend(place(spec.options, problem) for problem in problems)
        return Declared(spec.name, kind, options)

    def _resolve(
        self, spec: ComponentSpec, key: str, resolve: Callable[[str, Path], T]
    ) -> T | None:
        try:
            return resolve(spec.plugin, self.directory)
        except UserError as error:
            message = "; ".join(filter(None, (error.message, *error.details, error.hint)))
            slug = "unknown-plugin" if key == "plugin" else "unknown-provider"
            slug = "untrusted" if isinstance(error, Untrusted) else slug
            problem = Problem((*spec.path, key), message, slug)
            self.findings.append(place(self.rigelfile.root, problem))
            return None


def _find_named(what: str, name: str, known: Mapping[str, T]) -> T:
    if name in known:
        return known[name]
    near = find_nearest(name, known)
    raise UserError(
        f'unknown {what} "{name}"' + (f', did you mean "{near}"?' if near else ""),
        hint=f"its {what}s are {', '.join(known)}" if known else f"it has no {what}s",
    )
