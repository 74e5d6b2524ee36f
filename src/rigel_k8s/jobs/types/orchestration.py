"""The job that deploys: options to objects, objects to the cluster, results back.

It joins app/ and the guests; in each of them, decisions are pure and queries separate. They are
imported where they are used: `rigel status` needs only the options.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import attrs

from rigel_k8s.app.application import flat, is_partial
from rigel_k8s.app.deploying.target import release_key, release_of
from rigel_k8s.app.generation import generation_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.jobs.deploying import deploy
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application, Settings

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Part
    from rigel_k8s.release.types import ReleaseId


class OrchestrationJob:
    """Deploys the release that the options describe, and waits until it is ready."""

    options: ClassVar[type[OrchestrationOptions]] = OrchestrationOptions
    needs_cluster: ClassVar[bool] = True

    def check(self, options: OrchestrationOptions, application: Application) -> Sequence[Problem]:
        """Return what Kubernetes or ROS would refuse, or do differently than it looks."""
        from rigel_k8s.app.checks.application import check

        return tuple(check(options, application.distro))

    def check_files(
        self, options: OrchestrationOptions, application: Application, home: Path
    ) -> Sequence[Problem]:
        """Return what is wrong with the parameter files, and with `files`."""
        from rigel_k8s.app.deploying.localfiles import check_local_files
        from rigel_k8s.app.deploying.parameterfiles import check_parameter_files

        ros = generation_of(application.distro, options.ros)
        return (
            *check_parameter_files(options, ros, application.dir, home),
            *check_local_files(options, application.dir, home),
        )

    def exclusive(
        self, options: OrchestrationOptions, application: Application, settings: Settings
    ) -> str | None:
        """Return the release: two branches must not deploy it at the same time."""
        return release_key(options, settings)

    def release(
        self, options: OrchestrationOptions, settings: Settings, cluster: Cluster | None
    ) -> ReleaseId | None:
        """Return the release; a job of the observability stack alone has none."""
        return None if options.observability_only else release_of(options, settings, cluster)

    def workloads(self, options: OrchestrationOptions, application: Application) -> Sequence[str]:
        """Return the keys of its nodes, and the names of its other workloads."""
        from rigel_k8s.app.application import has_application

        ros = generation_of(application.distro, options.ros)
        own = [str(options.deployment_name)] if has_application(options) else []
        beside = ros.companions(options, application.distro)
        nodes = [str(key) for key, node in options.nodes.items() if node.kind != "test"]
        return [*nodes, *own, *(one.identity.name for one in beside)]

    def parts(
        self, options: OrchestrationOptions, job: JobContext, cluster: Cluster | None
    ) -> Sequence[Part]:
        """Return the application, and what guests add to it: its network, the stack.

        A partial job is laid over the release's last revision, so the cluster is asked for that
        even without one.
        """
        from rigel_k8s.app.deploying.guests import DeployRequest, load_guests
        from rigel_k8s.app.deploying.part import ApplicationHooks
        from rigel_k8s.app.deploying.prepare import Request, prepare, timeout_of
        from rigel_k8s.app.desired import point_out
        from rigel_k8s.kube import connect
        from rigel_k8s.release.part import Part

        guests = load_guests()
        asked = DeployRequest(
            options, flat(job.raw), cluster, job.report, job.application, job.settings
        )
        if options.observability_only:
            return [part for guest in guests for part in guest.parts(asked)]
        request = Request(
            options=options,
            raw=job.raw,
            application=job.application,
            settings=job.settings,
            data=job.data,
            providers=None if job.dry else job.providers,
        )
        if cluster is None and is_partial(job.raw):
            with connect(job.settings) as connected:
                prepared = prepare(request, connected)
        else:
            prepared = prepare(request, cluster)
        whole = attrs.evolve(asked, options=prepared.options, raw=prepared.raw)
        hooks = ApplicationHooks(
            prepared=prepared,
            application=job.application,
            settings=job.settings,
            applied=job.applied,
            guests=guests,
            beside=[made for guest in guests if (made := guest.hooks(whole))],
        )
        application = Part(
            desired=attrs.evolve(prepared.desired, source=str(job.application.dir.resolve())),
            timeout=timeout_of(prepared.options, job.settings),
            place=lambda found: job.place([point_out(one, job.raw) for one in found]),
            hooks=hooks,
        )
        return [application, *(part for guest in guests for part in guest.parts(whole))]

    def run(self, options: OrchestrationOptions, job: JobContext) -> None:
        """Deploy, and copy the results.

        Raises:
            UserError: the options do not fit the cluster or the release; nothing was written.
            ClusterError, RolloutFailed: it went wrong; the causes are in the details.
            DiscoveryError: it is deployed, and its DDS nodes do not discover each other.
            GraphWorse: it was rolled back, as `rollback_on` requests.
        """
        deploy(self, options, job)
