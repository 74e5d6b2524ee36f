"""run: a job or a sequence of the Rigelfile."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.errors import ProblemsError, UserError
from rigel_k8s.jobs import runner
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.jobs.steps import Job, list_jobs, list_uses
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.rigelfile.model import Rigelfile
from rigel_k8s.settings import Settings


def run(
    kind: Literal["job", "sequence"] | None, name: str, settings: Settings, report: JobReporter
) -> None:
    """Check all of it, then run it.

    Args:
        kind: None is what has the name, if it is not both.

    Raises:
        ProblemsError, UserError: the Rigelfile is wrong, or a job needs a cluster and none is
            configured; nothing ran.
        JobFailed: a job failed; the others were stopped.
        Interrupted: the user stopped it.
    """
    prepared = prepare(kind, name, settings)
    require_kubeconfig(prepared)
    runner.warn_and_run(prepared, report)


def prepare(
    kind: Literal["job", "sequence"] | None, name: str, settings: Settings
) -> runner.Prepared:
    """Return what was checked and can run. Raises ProblemsError, UserError as run."""
    rigelfile = load(settings)
    kind = kind or find_kind(rigelfile, name, "test" if settings.tests else "run")
    if kind == "sequence":
        return runner.prepare_sequence(rigelfile, name, settings)
    prepared = runner.prepare_job(rigelfile, name, settings)
    require_data(prepared)
    return prepared


def require_data(prepared: runner.Prepared) -> None:
    """Refuse a job that waits for data. Raises ProblemsError; names the sequences that pass it."""
    (job,) = list_jobs(prepared.steps)
    if prepared.values.is_complete(job):
        return
    try:
        prepared.values.realise(job, {})
    except ProblemsError as error:
        names = ", ".join(f"`rigel run sequence {name}`" for name in name_sequences(prepared, job))
        error.hint = f"a sequence passes it to the job: {names}" if names else error.hint
        raise


def name_sequences(prepared: runner.Prepared, job: Job) -> Iterator[str]:
    """Yield the sequences that run a job with a matrix, or after others, which may store data."""
    values, rigelfile = prepared.values, prepared.rigelfile
    for name in rigelfile.sequences:
        steps = runner.list_steps(rigelfile, name, prepared.settings)
        uses = list_uses(steps, lambda step, known: values.preview_matrix(step, known)[0])
        if any(use.name == job.name and (data or place) for place, (use, data) in enumerate(uses)):
            yield name


def find_kind(rigelfile: Rigelfile, name: str, command: str) -> Literal["job", "sequence"]:
    """Return what has a name. Raises UserError if nothing has it, or both."""
    if name in rigelfile.jobs and name in rigelfile.sequences:
        raise UserError(
            f'a job and a sequence are called "{name}"',
            hint=f"name which: `rigel {command} job {name}` or `rigel {command} sequence {name}`",
        )
    if name in rigelfile.jobs:
        return "job"
    if name in rigelfile.sequences:
        return "sequence"
    names = [*rigelfile.jobs, *rigelfile.sequences]
    raise UserError(
        f'no job and no sequence is called "{name}"{suggest(name, names)}',
        hint="`rigel check` reports what is wrong with the Rigelfile",
    )


def require_kubeconfig(prepared: runner.Prepared) -> None:
    """Refuse settings without a cluster if a job needs one; no connection is made."""
    from rigel_k8s.kube.kubeconfig import load

    job, settings = runner.find_cluster_job(prepared), prepared.settings
    if job is None:
        return
    try:
        load(settings.kubeconfig, settings.context)
    except UserError as error:
        message = f"the job {job} needs a cluster: {error.message}"
        raise UserError(message, hint=error.hint, details=error.details) from error
