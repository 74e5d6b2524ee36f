"""Around the deploy of an application: its ROS graph before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs

from rigel_k8s.app.expectations import describe_all
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import OrchestrationOptions, RollbackOn
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.release.part import Hooks, Look, Run, WayBack
from rigel_k8s.release.types import Plan, Revision

if TYPE_CHECKING:
    from rigel_graph.watching import GraphWatch

#: Seconds that a graph may stay worse before it is rolled back.
WITHIN = 60.0
#: The same where gaps are expected: one at a node's start is to be seen for a minute.
GAP_SEEN = 70.0
#: Seconds that an update waits for an idle robot.
IDLE = 600.0
#: The hint after a rollback because the graph became worse.
LOOK = (
    "see the current graph with `rigel graph`; to keep the update, remove `rollback_on`, or"
    " `else: rollback` of what is expected"
)


@attrs.define(kw_only=True)
class GraphHooks(Hooks):
    """Waits for an idle robot, compares its graph with that before, checks DDS discovery.

    Attributes:
        options: the application's.
        now: do not wait.
        graph: made when the application is written.
    """

    options: OrchestrationOptions
    ros: Generation
    now: bool
    graph: GraphWatch | None = None

    @property
    def limit(self) -> float | None:
        """How many seconds the graph may stay worse before a rollback; None: forever."""
        rollback, expected = self.options.rollback_on, self.options.expect.values()
        if not insists(rollback) and not any(one.otherwise == "rollback" for one in expected):
            return None
        if rollback is not None and rollback.within is not None:
            return rollback.within.seconds
        return GAP_SEEN if any(one.gap for one in expected) else WITHIN

    def before_pods(self, run: Run, plan: Plan) -> None:
        """Wait until the robot is idle, if pods are replaced and that is requested; read the graph.

        Raises:
            ClusterError: it is not idle within its time.
            Interrupted: the user asked to stop.
        """
        from rigel_graph.watching import PATIENCE, GraphWatch, changes_pods

        report, cancel, update = run.report, run.options.cancel, self.options.update
        if update and not self.now and any(map(changes_pods, plan.changes)):
            from rigel_graph.idle import wait_until_idle

            seconds = update.within.seconds if update.within else IDLE
            silent = {ros_name(topic): one.seconds for topic, one in update.silent.items()}
            wait_until_idle(run.cluster, run.release, report, cancel, seconds, silent)
        self.graph = GraphWatch(
            run.cluster,
            run.release,
            report,
            cancel,
            self.limit or PATIENCE,
            describe_all(self.options.expect),
            quick=not self.ros.dds or (self.ros.rmw and self.options.rmw_layer),
        )
        if not (self.ros.dds and self.ros.explain_unseen(self.options)):
            self.graph.begin(plan)

    def verify(self, run: Run) -> None:
        """Refuse an update that has made the graph worse, if `rollback_on` or `expect` says so.

        Raises:
            GraphWorse: it has.
        """
        if self.limit and self.graph is not None:
            self.graph.report(insist=insists(self.options.rollback_on))

    def way_back(self, run: Run, failure: RigelK8sError) -> WayBack | None:
        """Return the revision that was good before the graph became worse."""
        from rigel_graph.watching import GraphWorse

        if isinstance(failure, GraphWorse) and self.graph is not None:
            return WayBack(self.graph.last_good, LOOK)
        return None

    def after_write(self, run: Run, revision: Revision | None, seen: Look) -> None:
        """Report what the update did to the graph, unless `verify` has."""
        if not self.limit and self.graph is not None:
            self.graph.report()

    def watch(self, run: Run) -> None:
        """Check that DDS nodes discover each other; ROS 1 nodes find each other by their master.

        Raises:
            DiscoveryError: they do not.
        """
        if self.ros.dds:
            from rigel_graph.discovery.check import check

            notes = self.graph.notes if self.graph is not None else {}
            check(run.release, run.cluster, run.report, run.options.cancel, notes)


def insists(rollback: RollbackOn | None) -> bool:
    """Whether all that is worse in the graph rolls an update back, not only expectations."""
    return rollback is not None and rollback.graph_worse
