"""The job that installs Multus and whereabouts, for sequences that prepare a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from rigel_k8s.jobs.deploying import deploy
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.network.checks import check_install
from rigel_k8s.network.options import Install
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application, Settings

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Part


class NetworkJob:
    """Installs Multus and whereabouts, and waits until every machine attaches pods."""

    options: ClassVar[type[Install]] = Install
    needs_cluster: ClassVar[bool] = True

    def check(self, options: Install, application: Application) -> Sequence[Problem]:
        return tuple(check_install(options))

    def exclusive(
        self, options: Install, application: Application, settings: Settings
    ) -> str | None:
        """Return the cluster's network: two branches must not install it at the same time."""
        return "the cluster's network"

    def parts(self, options: Install, job: JobContext, cluster: Cluster | None) -> Sequence[Part]:
        """Return both as one release."""
        from rigel_multus.install import multus_part

        return [multus_part(options, cluster)]

    def run(self, options: Install, job: JobContext) -> None:
        """Install. Raises as jobs.deploying.deploy."""
        from rigel_multus.install import describe, result_of

        [multus] = deploy(self, options, job)
        job.report.line(describe(result_of(multus)))
