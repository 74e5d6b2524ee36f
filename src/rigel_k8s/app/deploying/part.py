"""An application as a part of a job: looked at before, written, compared with before, watched."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from threading import Event

import attrs

from rigel_k8s.app.deploying.images import write_pull_secret
from rigel_k8s.app.deploying.prepare import Preparation, timeout_of
from rigel_k8s.app.deploying.results import copy_results
from rigel_k8s.errors import Interrupted, RigelK8sError, RolloutFailed
from rigel_k8s.generation import Generation, generation_of
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.preflight.examine import inspect
from rigel_k8s.release.deploy import Look, deploy_release
from rigel_k8s.release.rollback import find_target, undo
from rigel_k8s.release.run import Run
from rigel_k8s.release.together import Inspection, Part, PartLook
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.settings import Application, Settings

#: Seconds that a graph may stay worse before it is rolled back.
WITHIN = 60.0
#: Hints after a rollback: because it did not become ready, and because the graph became worse.
CORRECT = "fix the cause, then run it again"
LOOK = "see the current graph with `rigel graph`; to keep the update, remove `rollback_on`"


@attrs.define(kw_only=True)
class ApplicationPart(Part):
    """One ROS application.

    Attributes:
        applied: set when its objects are stored, before they are waited for.
    """

    prepared: Preparation
    application: Application
    settings: Settings
    applied: Event

    @property
    def ros(self) -> Generation:
        """Which ROS it is."""
        return generation_of(self.application.distro, self.prepared.options.ros)

    @property
    def limit(self) -> float | None:
        """How many seconds the graph may stay worse before a rollback; None: forever."""
        rollback = self.prepared.options.rollback_on
        if rollback is None or not rollback.graph_worse:
            return None
        return rollback.within.seconds if rollback.within else WITHIN

    def inspect(self, cluster: Cluster, earlier: Sequence[PartLook]) -> Inspection:
        """Return what keeps its network from working, or may.

        What an installation of Multus mends is looked at after that.
        """
        installs = any(one.part.rank == "network" and one.writes for one in earlier)
        network = self.prepared.options.network
        error, warnings = inspect(self.desired.objects, network, cluster, mended=installs)
        return Inspection((error,) if error else (), warnings)

    def write(self, cluster: Cluster, looked: Look, options: DeployOptions) -> None:
        """Deploy, and report what an update did to the ROS graph; roll back if that is requested.

        Raises:
            GraphWorse: it was rolled back, as `rollback_on` requests.
        """
        from rigel_k8s.rosgraph.watching import PATIENCE, GraphWatch, GraphWorse

        options = attrs.evolve(options, timeout=timeout_of(self.prepared.options, self.settings))
        write_pull_secret(self.desired, self.prepared.credentials, cluster)
        watch = GraphWatch(
            cluster, self.release, options.report, options.cancel, self.limit or PATIENCE
        )
        readable = not (self.ros.dds and self.ros.explain_unseen(self.prepared.options))
        run = Run(
            cluster=cluster,
            desired=self.desired,
            options=options,
            before=watch.begin if readable else None,
            applied=self.applied.set,
            verify=partial(watch.report, insist=True) if self.limit else None,
        )
        try:
            revision = deploy_release(run, looked)
        except RolloutFailed as failure:
            if not self.settings.rollback_on_failure:
                raise
            target = find_target(cluster, self.release)
            raise undo(cluster, self.release, failure, target, options, hint=CORRECT) from failure
        except GraphWorse as worse:
            last = watch.last_good
            raise undo(cluster, self.release, worse, last, options, hint=LOOK) from worse
        where = f"{self.release.name} in {self.release.namespace}"
        options.report.line(f"{where} is at revision {revision.number}")
        if not self.limit:
            watch.report()

    def watch(self, cluster: Cluster, options: DeployOptions) -> None:
        """Check that DDS nodes discover each other, and copy the results.

        Raises:
            GraphError: they do not; ROS 1 nodes find each other by their master.
        """
        if self.ros.dds:
            from rigel_k8s.discovery.check import check as check_graph

            check_graph(self.release, cluster, options.report, options.cancel)
        results = self.prepared.options.results
        if results is None:
            return
        target = self.application.dir / results.target
        try:
            copied = copy_results(results, self.release, cluster, target, options.cancel)
        except RigelK8sError as error:
            if results.wait is not None or isinstance(error, Interrupted):
                raise
            options.report.warn(f"{error.message}; `results: {{wait: 1m}}` would wait for them")
        else:
            options.report.line(f"results copied to {copied}")
