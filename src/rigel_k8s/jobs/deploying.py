"""What all job types that deploy have in common: their parts, deployed together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from rigel_k8s.jobs.job import JobContext, O_contra

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Part
    from rigel_k8s.release.types import ReleaseId
    from rigel_k8s.settings import Settings


@runtime_checkable
class Deploys(Protocol[O_contra]):
    """A job type that deploys: `render`, `diff` and `run` work for it."""

    def parts(self, options: O_contra, job: JobContext, cluster: Cluster | None) -> Sequence[Part]:
        """Return what a job deploys (release/part.py); nothing is written.

        Its `run` is then `jobs.deploying.deploy(self, options, job)`. Without a cluster (`render`),
        the parts are as far as the Rigelfile describes them.
        """


@runtime_checkable
class HasRelease(Protocol[O_contra]):
    """A job type with a release: `status`, `history`, `rollback` and `down` work for it."""

    def release(
        self, options: O_contra, settings: Settings, cluster: Cluster | None
    ) -> ReleaseId | None:
        """Return the release that is this job's own.

        None: it deploys only what all applications of a cluster share.
        """


def deploy(kind: Deploys[O_contra], options: O_contra, job: JobContext) -> Sequence[Part]:
    """Deploy what a job describes, and return its parts. Raises as rigel_k8s.deploy.deploy."""
    from rigel_k8s import deploy as deploys
    from rigel_k8s.kube import connect

    with connect(job.settings) as cluster:
        cluster.endure(job.report.line, job.cancel)
        parts = kind.parts(options, job, cluster)
        deploys.deploy(parts, cluster, job.deploy_options)
    return parts
