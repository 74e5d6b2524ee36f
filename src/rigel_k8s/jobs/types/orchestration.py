"""The job that deploys: options to objects, objects to the cluster, results back.

It joins app/, network/, graph/, rosgraph/ and observability/; in each of them, decisions are pure
and queries separate. They are imported where they are used: `rigel status` needs only the options.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

import attrs

from rigel_k8s.app.deploying.target import release_key
from rigel_k8s.app.distros import ros_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.partial import flat
from rigel_k8s.errors import Interrupted, RigelK8sError, RolloutFailed
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application, Settings

if TYPE_CHECKING:
    from rigel_k8s.app.deploying.prepare import Preparation
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.types import DeployOptions

Failure = TypeVar("Failure", bound=RigelK8sError)

#: Seconds that a graph may stay worse before it is rolled back.
WITHIN = 60.0
#: Hints after a rollback: because it did not become ready, and because the graph became worse.
CORRECT = "fix the cause, then run it again"
LOOK = "see the current graph with `rigel graph`; to keep the update, remove `rollback_on`"


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
        """Return what is wrong with the parameter files."""
        from rigel_k8s.app.deploying.parameterfiles import check_parameter_files

        return tuple(check_parameter_files(options, application.dir, home))

    def exclusive(
        self, options: OrchestrationOptions, application: Application, settings: Settings
    ) -> str | None:
        """Return the release: two branches must not deploy it at the same time."""
        return release_key(options, settings)

    def run(self, options: OrchestrationOptions, job: JobContext) -> None:
        """Deploy, and copy the results.

        Raises:
            UserError: the options do not fit the cluster or the release; nothing was written.
            ClusterError, RolloutFailed: it went wrong; the causes are in the details.
            GraphError: it is deployed, and its DDS nodes do not discover each other.
            GraphWorse: it was rolled back, as `rollback_on` requests.

        If only the observability stack does not become ready, the application is deployed and
        the stack's RolloutFailed raised afterwards.
        """
        from rigel_k8s.app.deploying.places import check_places
        from rigel_k8s.app.deploying.prepare import prepare
        from rigel_k8s.app.deploying.secrets import write_pull_secret
        from rigel_k8s.jobs.types.observability import run as run_stack
        from rigel_k8s.kube import connect
        from rigel_k8s.observability.request import request_of

        if options.observability_only:
            run_stack(request_of(flat(job.raw).get("observability") or {}), job)
            return
        with connect(job.settings) as cluster:
            cluster.endure(job.report.line, job.cancel)
            prepared = prepare(
                options,
                job.raw,
                job.application,
                job.settings,
                cluster,
                data=job.data,
                providers=job.providers,
                preflight=True,
            )
            check_places(prepared.desired.objects, cluster)
            _ready_the_network(prepared, cluster, job)
            late = _observe(prepared, cluster, job)
            write_pull_secret(
                prepared.desired,
                prepared.credentials,
                cluster,
                before=lambda: _refuse(prepared, cluster, job),
            )
            _deploy(prepared, cluster, job)
            _check_graph(prepared, cluster, job)
            _copy_results(prepared, cluster, job)
            if late is not None:
                raise late


def _deploy(prepared: Preparation, cluster: Cluster, job: JobContext) -> None:
    """Deploy, and report what an update did to the ROS graph; roll back if that is requested."""
    from rigel_k8s.app.checks.exporter import speaks_zenoh
    from rigel_k8s.release.deploy import deploy
    from rigel_k8s.release.rollback import find_target
    from rigel_k8s.rosgraph.watching import PATIENCE, GraphWatch, GraphWorse

    release, options = prepared.desired.release, prepared.options
    within = _find_limit(options)
    watch = GraphWatch(cluster, release, job.report, job.cancel, within or PATIENCE)
    readable = not speaks_zenoh(options, ros_of(job.application.distro, options.ros))
    try:
        with _placing_refusals(job):
            revision = deploy(
                prepared.desired,
                cluster,
                _deploy_options(prepared, job),
                before=watch.begin if readable else None,
                applied=job.applied.set,
                verify=watch.insist if within else None,
            )
    except RolloutFailed as failure:
        if not job.settings.rollback_on_failure:
            raise
        target = find_target(cluster, release)
        raise _undo(failure, target, CORRECT, prepared, cluster, job) from failure
    except GraphWorse as worse:
        raise _undo(worse, watch.last_good, LOOK, prepared, cluster, job) from worse
    job.report.line(f"{release.name} in {release.namespace} is at revision {revision.number}")
    if not within:
        watch.report()


def _refuse(prepared: Preparation, cluster: Cluster, job: JobContext) -> None:
    """Raise if the deploy will be refused, before anything is written."""
    from rigel_k8s.release.deploy import diff

    with _placing_refusals(job):
        diff(prepared.desired, cluster, adopt=job.settings.adopt)


@contextmanager
def _placing_refusals(job: JobContext) -> Iterator[None]:
    """Add the places in the Rigelfile to the problems of a refusal."""
    from rigel_k8s.release.refusals.verdict import Refused

    try:
        yield
    except Refused as refused:
        refused.details = tuple(job.place(refused.problems))
        raise


def _find_limit(options: OrchestrationOptions) -> float | None:
    """Return how many seconds the graph may stay worse before a rollback; None: forever."""
    rollback = options.rollback_on
    if rollback is None or not rollback.graph_worse:
        return None
    return rollback.within.seconds if rollback.within else WITHIN


def _undo(
    failure: Failure,
    target: int | None,
    hint: str,
    prepared: Preparation,
    cluster: Cluster,
    job: JobContext,
) -> Failure:
    """Roll an update back, and return the error with the reason and the result."""
    from rigel_k8s.release.rollback import undo

    options = _deploy_options(prepared, job)
    return undo(cluster, prepared.desired.release, failure, target, options, hint=hint)


def _deploy_options(prepared: Preparation, job: JobContext) -> DeployOptions:
    """Return how the application is deployed."""
    from rigel_k8s.app.deploying.prepare import timeout_of

    return attrs.evolve(
        job.deploy_options,
        timeout=timeout_of(prepared.options, job.settings),
        description=job.settings.description or job.name,
    )


def _observe(prepared: Preparation, cluster: Cluster, job: JobContext) -> RolloutFailed | None:
    """Install the observability stack if the job requests one.

    Returns:
        Why it does not become ready. Robots do not wait for dashboards: it is reported at the end.
    """
    if prepared.stack is None:
        return None
    from rigel_k8s.observability.install import ensure

    try:
        ensure(cluster, prepared.stack, job.deploy_options)
    except RolloutFailed as error:
        job.report.warn(f"{error.message}; the application is deployed anyway")
        return error
    return None


def _ready_the_network(prepared: Preparation, cluster: Cluster, job: JobContext) -> None:
    """Install what the network needs, and refuse a cluster where it cannot work."""
    network = prepared.options.network
    if network is None:
        return
    from rigel_k8s.network.preflight.examine import check, report_findings

    if prepared.findings is not None:
        report_findings(prepared.findings, job.report)
        return
    from rigel_k8s.network.multus.install import ensure, install_requested_by

    options = install_requested_by(network)
    if options is not None:
        ensure(cluster, options, job.deploy_options)
    check(prepared.desired.objects, network, cluster, job.report)


def _check_graph(prepared: Preparation, cluster: Cluster, job: JobContext) -> None:
    """Check that DDS nodes discover each other; ROS 1 nodes find each other by their master."""
    if ros_of(job.application.distro, prepared.options.ros) == "1":
        return
    from rigel_k8s.discovery.check import check as check_graph

    check_graph(prepared.desired.release, cluster, job.report, job.cancel)


def _copy_results(prepared: Preparation, cluster: Cluster, job: JobContext) -> None:
    results = prepared.options.results
    if results is None:
        return
    from rigel_k8s.app.deploying.results import copy_results

    target = job.application.dir / results.target
    try:
        copied = copy_results(results, prepared.desired.release, cluster, target, job.cancel)
    except RigelK8sError as error:
        if results.wait is not None or isinstance(error, Interrupted):
            raise
        job.report.warn(f"{error.message}; `results: {{wait: 1m}}` would wait for them")
    else:
        job.report.line(f"results copied to {copied}")
