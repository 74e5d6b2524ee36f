"""run: a job or a sequence of the Rigelfile."""

from __future__ import annotations

from typing import Literal

from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.errors import UserError
from rigel_k8s.jobs import runner
from rigel_k8s.jobs.job import JobReporter
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
    rigelfile = load(settings)
    kind = kind or find_kind(rigelfile, name)
    prepare = runner.prepare_job if kind == "job" else runner.prepare_sequence
    prepared = prepare(rigelfile, name, settings)
    if job := runner.find_cluster_job(prepared):
        require_kubeconfig(job, settings)
    runner.warn_and_run(prepared, report)


def find_kind(rigelfile: Rigelfile, name: str) -> Literal["job", "sequence"]:
    """Return what has a name. Raises UserError if nothing has it, or both."""
    if name in rigelfile.jobs and name in rigelfile.sequences:
        raise UserError(
            f'a job and a sequence are called "{name}"',
            hint=f"name which: `rigel run job {name}` or `rigel run sequence {name}`",
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


def require_kubeconfig(job: str, settings: Settings) -> None:
    """Refuse settings without a cluster for a job; no connection is made."""
    from rigel_k8s.kube.kubeconfig import load

    try:
        load(settings.kubeconfig, settings.context)
    except UserError as error:
        message = f"the job {job} needs a cluster: {error.message}"
        raise UserError(message, hint=error.hint, details=error.details) from error
