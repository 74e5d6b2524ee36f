"""An application as a part of a job: looked at before, written, compared with before, watched."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from threading import Event
from typing import TYPE_CHECKING

import attrs

from rigel_k8s.app.deploying.images import write_pull_secret
from rigel_k8s.app.deploying.prepare import Preparation, timeout_of
from rigel_k8s.app.deploying.results import copy_results
from rigel_k8s.app.expectations import describe_all
from rigel_k8s.app.options import RollbackOn
from rigel_k8s.errors import Interrupted, RigelK8sError, RolloutFailed
from rigel_k8s.generation import Generation, generation_of
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.preflight.examine import inspect
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.release.deploy import Look, deploy_release
from rigel_k8s.release.rollback import find_target, undo
from rigel_k8s.release.run import Run
from rigel_k8s.release.together import Inspection, Part, PartLook
from rigel_k8s.release.types import DeployOptions, Plan
from rigel_k8s.settings import Application, Settings

if TYPE_CHECKING:
    from rigel_k8s.rosgraph.watching import GraphWatch

#: Seconds that a graph may stay worse before it is rolled back.
WITHIN = 60.0
#: The same where gaps are expected: one at a node's start is to be seen for a minute.
GAP_SEEN = 70.0
#: Seconds that an update waits for an idle robot.
IDLE = 600.0
#: Hints after a rollback: because it did not become ready, and because the graph became worse.
CORRECT = "fix the cause, then run it again"
LOOK = (
    "see the current graph with `rigel graph`; to keep the update, remove `rollback_on`, or"
    " `else: rollback` of what is expected"
)


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
        options = self.prepared.options
        rollback, expected = options.rollback_on, options.expect.values()
        if not insists(rollback) and not any(one.otherwise == "rollback" for one in expected):
            return None
        if rollback is not None and rollback.within is not None:
            return rollback.within.seconds
        return GAP_SEEN if any(one.gap for one in expected) else WITHIN

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
            GraphWorse: it was rolled back, as `rollback_on` or `expect` requests.
        """
        from rigel_k8s.rosgraph.watching import PATIENCE, GraphWatch, GraphWorse

        options = attrs.evolve(options, timeout=timeout_of(self.prepared.options, self.settings))
        write_pull_secret(self.desired, self.prepared.credentials, cluster)
        watch = GraphWatch(
            cluster,
            self.release,
            options.report,
            options.cancel,
            self.limit or PATIENCE,
            describe_all(self.prepared.options.expect),
            quick=not self.ros.dds or (self.ros.rmw and self.prepared.options.rmw_layer),
        )
        strict = insists(self.prepared.options.rollback_on)
        readable = not (self.ros.dds and self.ros.explain_unseen(self.prepared.options))
        run = Run(
            cluster=cluster,
            desired=self.desired,
            options=options,
            before=partial(self.begin, watch if readable else None, options, cluster),
            applied=self.applied.set,
            verify=partial(watch.report, insist=strict) if self.limit else None,
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

    def begin(
        self, watch: GraphWatch | None, options: DeployOptions, cluster: Cluster, plan: Plan
    ) -> None:
        """Wait until the robot is idle, if pods are replaced and that is requested; read the graph.

        Raises:
            ClusterError: it is not idle within its time.
            Interrupted: `cancel` was set.
        """
        from rigel_k8s.rosgraph.watching import changes_pods

        update = self.prepared.options.update
        if update and not self.settings.now and any(map(changes_pods, plan.changes)):
            from rigel_k8s.rosgraph.idle import wait_until_idle

            seconds = update.within.seconds if update.within else IDLE
            silent = {ros_name(topic): one.seconds for topic, one in update.silent.items()}
            wait_until_idle(cluster, self.release, options.report, options.cancel, seconds, silent)
        if watch is not None:
            watch.begin(plan)

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


def insists(rollback: RollbackOn | None) -> bool:
    """Whether all that is worse in the graph rolls an update back, not only expectations."""
    return rollback is not None and rollback.graph_worse
