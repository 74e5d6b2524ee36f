"""The job that deploys only the observability stack; orchestration jobs use it too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from rigel_k8s.jobs.job import JobContext
from rigel_k8s.observability.checks import check
from rigel_k8s.observability.options import ObservabilityOptions
from rigel_k8s.observability.request import StackRequest, request_of
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application, Settings


class ObservabilityJob:
    """Installs Loki, Promtail, Prometheus and Grafana on the cluster, for all applications."""

    options: ClassVar[type[ObservabilityOptions]] = ObservabilityOptions
    needs_cluster: ClassVar[bool] = True

    def check(self, options: ObservabilityOptions, application: Application) -> Sequence[Problem]:
        """Return contradictions, and what a program of the stack would refuse."""
        return tuple(check(options))

    def exclusive(
        self, options: ObservabilityOptions, application: Application, settings: Settings
    ) -> str | None:
        """Return the cluster's stack: two branches must not change it at the same time."""
        return "the cluster's observability stack"

    def run(self, options: ObservabilityOptions, job: JobContext) -> None:
        """Install.

        Raises: as observability.install.
        """
        if not options.enabled:
            job.report.line("observability.enabled is false: nothing to do")
            return
        run(request_of(job.raw), job)


def run(request: StackRequest, job: JobContext) -> None:
    """Install the stack that a job requests, and report what was done.

    Raises: as observability.install.
    """
    from rigel_k8s.kube import connect
    from rigel_k8s.observability.install import describe, install

    with connect(job.settings) as cluster:
        cluster.endure(job.report.line, job.cancel)
        done = install(cluster, request, job.deploy_options)
    job.report.line(describe(done))
