"""run: a job or a sequence of the Rigelfile."""

from __future__ import annotations

from typing import Literal

from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.errors import UserError
from rigel_k8s.jobs import runner
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.settings import Settings


def run(
    kind: Literal["job", "sequence"], name: str, settings: Settings, report: JobReporter
) -> None:
    """Check all of it, then run it.

    Raises:
        ProblemsError, UserError: the Rigelfile is wrong, or a job needs a cluster and none is
            configured; nothing ran.
        JobFailed: a job failed; the others were stopped.
        Interrupted: the user stopped it.
    """
    prepare = runner.prepare_job if kind == "job" else runner.prepare_sequence
    prepared = prepare(load(settings), name, settings)
    if job := runner.find_cluster_job(prepared):
        require_kubeconfig(job, settings)
    runner.warn_and_run(prepared, report)


def require_kubeconfig(job: str, settings: Settings) -> None:
    """Refuse settings without a cluster for a job; no connection is made."""
    from rigel_k8s.kube.kubeconfig import load

    try:
        load(settings.kubeconfig, settings.context)
    except UserError as error:
        message = f"the job {job} needs a cluster: {error.message}"
        raise UserError(message, hint=error.hint, details=error.details) from error
