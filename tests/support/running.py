"""A job or a sequence that is checked and run in one call, as `rigel run` does."""

from __future__ import annotations

from typing import Any

from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.jobs.runner import prepare_job, prepare_sequence, warn_and_run
from rigel_k8s.rigelfile import Rigelfile
from rigel_k8s.settings import Settings


def run_job(
    rigelfile: Rigelfile, name: str, *, settings: Settings, report: JobReporter
) -> dict[str, Any]:
    return warn_and_run(prepare_job(rigelfile, name, settings), report)


def run_sequence(
    rigelfile: Rigelfile, name: str, *, settings: Settings, report: JobReporter
) -> dict[str, Any]:
    return warn_and_run(prepare_sequence(rigelfile, name, settings), report)
