"""What all job types that deploy have in common: their parts, deployed together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, TypeVar

from rigel_k8s.jobs.job import JobContext

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Part

O_contra = TypeVar("O_contra", contravariant=True)


class Deploys(Protocol[O_contra]):
    """A job type that deploys."""

    def parts(self, options: O_contra, job: JobContext, cluster: Cluster | None) -> Sequence[Part]:
        """Return what a job would deploy; see jobs.job.JobType."""


def deploy(kind: Deploys[O_contra], options: O_contra, job: JobContext) -> Sequence[Part]:
    """Deploy what a job describes, and return its parts. Raises as rigel_k8s.deploy.deploy."""
    from rigel_k8s import deploy as deploys
    from rigel_k8s.kube import connect

    with connect(job.settings) as cluster:
        cluster.endure(job.report.line, job.cancel)
        parts = kind.parts(options, job, cluster)
        deploys.deploy(parts, cluster, job.deploy_options)
    return parts
