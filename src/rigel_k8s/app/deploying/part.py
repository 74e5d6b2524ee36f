"""An application as a part of a job: looked at before, written, compared with before, watched."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Event
from typing import TYPE_CHECKING

import attrs

from rigel_k8s.app.deploying.guests import Guest
from rigel_k8s.app.deploying.images import write_pull_secret
from rigel_k8s.app.deploying.prepare import Preparation
from rigel_k8s.app.deploying.results import copy_results
from rigel_k8s.app.expectations import describe_all
from rigel_k8s.app.generation import Generation, generation_of
from rigel_k8s.app.options import RollbackOn
from rigel_k8s.errors import Interrupted, RigelK8sError, RolloutFailed
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.release.part import Hooks, Inspection, Look, Run, WayBack
from rigel_k8s.release.rollback import find_target
from rigel_k8s.release.types import Plan, Revision
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
class ApplicationHooks(Hooks):
    """Around an application: its network before, its ROS graph before and after, its results.

    Attributes:
        applied: set when its objects are stored, before they are waited for.
        guests: look at the cluster, too, before anything is written.
        graph: compares the graph with that before; made when it is written.
    """

    prepared: Preparation
    application: Application
    settings: Settings
    applied: Event
    guests: Sequence[Guest] = ()
    graph: GraphWatch | None = None

    @property
    def ros(self) -> Generation:
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

    def inspect(self, cluster: Cluster, earlier: Sequence[Look]) -> Inspection:
        """Return what keeps it from working on this cluster, or may."""
        mended = any(one.part.rank == "network" and one.writes for one in earlier)
        options, objects = self.prepared.options, self.prepared.desired.objects
        looks = (one.inspect(objects, options, cluster, mended=mended) for one in self.guests)
        seen = list(filter(None, looks))
        return Inspection(
            [error for one in seen for error in one.errors],
            [warning for one in seen for warning in one.warnings],
        )

    def before_write(self, run: Run, seen: Look) -> None:
        """Write the Secret with which its images are pulled."""
        write_pull_secret(run.desired, self.prepared.credentials, run.cluster)

    def before_pods(self, run: Run, plan: Plan) -> None:
        """Wait until the robot is idle, if pods are replaced and that is requested; read the graph.

        Raises:
            ClusterError: it is not idle within its time.
            Interrupted: the user asked to stop.
        """
        from rigel_k8s.rosgraph.watching import PATIENCE, GraphWatch, changes_pods

        options, requested = run.options, self.prepared.options
        update = requested.update
        if update and not self.settings.now and any(map(changes_pods, plan.changes)):
            from rigel_k8s.rosgraph.idle import wait_until_idle

            seconds = update.within.seconds if update.within else IDLE
            silent = {ros_name(topic): one.seconds for topic, one in update.silent.items()}
            wait_until_idle(
                run.cluster, run.release, options.report, options.cancel, seconds, silent
            )
        self.graph = GraphWatch(
            run.cluster,
            run.release,
            options.report,
            options.cancel,
            self.limit or PATIENCE,
            describe_all(requested.expect),
            quick=not self.ros.dds or (self.ros.rmw and requested.rmw_layer),
        )
        if not (self.ros.dds and self.ros.explain_unseen(requested)):
            self.graph.begin(plan)

    def stored(self) -> None:
        """Let what waits for the objects go on."""
        self.applied.set()

    def verify(self, run: Run) -> None:
        """Refuse an update that has made the graph worse, if `rollback_on` or `expect` says so.

        Raises:
            GraphWorse: it has.
        """
        if self.limit and self.graph is not None:
            self.graph.report(insist=insists(self.prepared.options.rollback_on))

    def way_back(self, run: Run, failure: RigelK8sError) -> WayBack | None:
        """Return the revision before, if the Rigelfile or the user requests a rollback."""
        from rigel_k8s.rosgraph.watching import GraphWorse

        if isinstance(failure, GraphWorse) and self.graph is not None:
            return WayBack(self.graph.last_good, LOOK)
        if isinstance(failure, RolloutFailed) and self.settings.rollback_on_failure:
            return WayBack(find_target(run.cluster, run.release), CORRECT)
        return None

    def after_write(self, run: Run, revision: Revision | None, seen: Look) -> None:
        """Report its revision, and what the update did to the graph."""
        if revision is not None:
            run.report.line(f"{run.where} is at revision {revision.number}")
        if not self.limit and self.graph is not None:
            self.graph.report()

    def watch(self, run: Run) -> None:
        """Check that DDS nodes discover each other, and copy the results.

        Raises:
            DiscoveryError: they do not; ROS 1 nodes find each other by their master.
        """
        options = run.options
        if self.ros.dds:
            from rigel_k8s.rosgraph.discovery.check import check as check_graph

            notes = self.graph.notes if self.graph is not None else {}
            check_graph(run.release, run.cluster, options.report, options.cancel, notes)
        results = self.prepared.options.results
        if results is None:
            return
        target = self.application.dir / results.target
        try:
            copied = copy_results(results, run.release, run.cluster, target, options.cancel)
        except RigelK8sError as error:
            if results.wait is not None or isinstance(error, Interrupted):
                raise
            run.report.warn(f"{error.message}; `results: {{wait: 1m}}` would wait for them")
        else:
            run.report.line(f"results copied to {copied}")


def insists(rollback: RollbackOn | None) -> bool:
    """Whether all that is worse in the graph rolls an update back, not only expectations."""
    return rollback is not None and rollback.graph_worse
