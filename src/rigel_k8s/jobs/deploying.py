"""What all job types that deploy have in common: their parts, deployed together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, TypeVar

from rigel_k8s.jobs.job import JobContext

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.together import Part

O_contra = TypeVar("O_contra", contravariant=True)
P_co = TypeVar("P_co", bound="Part", covariant=True)


class Deploys(Protocol[O_contra, P_co]):
    """A job type that deploys."""

    def parts(self, options: O_contra, job: JobContext, cluster: Cluster | None) -> Sequence[P_co]:
        """Return what a job would deploy; see jobs.job.JobType."""


def deploy(kind: Deploys[O_contra, P_co], options: O_contra, job: JobContext) -> Sequence[P_co]:
    """Deploy what a job describes, and return its parts. Raises as release.together.deploy."""
    from rigel_k8s.kube import connect
    from rigel_k8s.release import together

    with connect(job.settings) as cluster:
        cluster.endure(job.report.line, job.cancel)
        parts = kind.parts(options, job, cluster)
        together.deploy(parts, cluster, job.deploy_options)
    return parts
