"""What the ROS graph adds to an application: to its deploy, status and tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rigel_k8s.app.deploying.guests import DeployRequest, Guest, State, StatusAddition

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Hooks, Run
    from rigel_k8s.release.status import ReleaseStatus


class GraphGuest(Guest):
    """The graph of a release's ROS nodes."""

    def hooks(self, request: DeployRequest) -> Hooks:
        """Return what waits for an idle robot, and compares its graph."""
        from rigel_graph.hooks import GraphHooks
        from rigel_k8s.app.generation import generation_of

        ros = generation_of(request.application.distro, request.options.ros)
        return GraphHooks(options=request.options, ros=ros, now=request.settings.now)

    def status(self, cluster: Cluster, release: ReleaseStatus) -> StatusAddition:
        """Return what is seen from inside its pods."""
        from rigel_graph.status import look

        return look(cluster, release)

    def test(self, run: Run, wait: float) -> Sequence[tuple[str, State, str]]:
        """Return whether topics are as `expect` has them."""
        from rigel_graph.commands.expect import test

        return test(run, wait)


GUEST = GraphGuest()
