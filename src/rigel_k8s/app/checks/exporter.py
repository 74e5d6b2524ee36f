"""Why an application cannot have the ROS exporter that it requests; pure."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.generation import Generation
from rigel_k8s.objects.naming import object_name
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.problems import Problem


def check_exporter(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what hides the graph from the exporter, and what has the exporter's name."""
    wanted = options.observability
    if wanted.exporter is None:
        return
    if why := ros.explain_unseen(options):
        if wanted.ros_metrics:
            yield Problem(("observability", "ros_metrics"), why, "no-ros-metrics", at_key=True)
        else:
            path = ("observability",)
            yield Problem(path, why, "no-ros-metrics", severity="warning", at_key=True)
    for key in options.nodes:
        if object_name(str(key)) == EXPORTER:
            message = f'"{EXPORTER}" is the name of the exporter of ros_metrics: choose another'
            yield Problem(("nodes", str(key)), message, "name-taken", at_key=True)
