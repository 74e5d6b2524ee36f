"""run: a job or a sequence of the Rigelfile."""

from __future__ import annotations

from typing import Literal

from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.jobs import runner
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.settings import Settings


def run(
    kind: Literal["job", "sequence"], name: str, settings: Settings, report: JobReporter
) -> None:
    """Check all of it, then run it.

    Raises:
        ProblemsError, UserError: the Rigelfile is wrong; nothing ran.
        JobFailed: a job failed; the others were stopped.
        Interrupted: the user stopped it.
    """
    work = runner.run_job if kind == "job" else runner.run_sequence
    work(load(settings), name, settings=settings, report=report)
