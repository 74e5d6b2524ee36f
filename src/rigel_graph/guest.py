"""What the ROS graph adds to a deploy: it is looked at before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rigel_k8s.app.deploying.guests import DeployRequest, Guest

if TYPE_CHECKING:
    from rigel_k8s.release.part import Hooks


class GraphGuest(Guest):
    """The graph of a release's ROS nodes."""

    def hooks(self, request: DeployRequest) -> Hooks:
        """Return what waits for an idle robot, and compares its graph."""
        from rigel_graph.hooks import GraphHooks
        from rigel_k8s.app.generation import generation_of

        ros = generation_of(request.application.distro, request.options.ros)
        return GraphHooks(options=request.options, ros=ros, now=request.settings.now)


GUEST = GraphGuest()
