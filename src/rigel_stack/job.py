"""The job that deploys only the observability stack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from rigel_k8s.jobs.deploying import deploy
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.observability.checks import check
from rigel_k8s.observability.options import ObservabilityOptions, request_of
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application, Settings

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Part


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

    def parts(
        self, options: ObservabilityOptions, job: JobContext, cluster: Cluster | None
    ) -> Sequence[Part]:
        """Return the stack; nothing if it is switched off."""
        from rigel_stack.install import stack_part

        return [stack_part(request_of(job.raw), cluster)] if options.enabled else []

    def run(self, options: ObservabilityOptions, job: JobContext) -> None:
        """Install it. Raises as jobs.deploying.deploy."""
        if not options.enabled:
            job.report.line("observability.enabled is false: nothing to do")
            return
        deploy(self, options, job)
