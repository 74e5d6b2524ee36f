"""Why an application cannot have the ROS exporter that it requests; pure."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.naming import Ros, object_name
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.problems import Problem

ZENOH = (
    "ros_metrics: the exporter supports DDS but not zenoh, so this application has no metrics of"
    " its ROS graph; set `ros_metrics: false` to turn this warning off"
)
NO_MASTER = (
    "ros_metrics: the exporter needs a ROS master that other pods reach: set ros_master_uri, remove"
    " deploy_ros_master, or set `ros_metrics: false`"
)


def can_be_seen(options: OrchestrationOptions, ros: Ros) -> bool:
    """Return whether an exporter could see the application's graph."""
    return reason(options, ros) is None


def reason(options: OrchestrationOptions, ros: Ros) -> str | None:
    """Return why an exporter would see nothing, None if it would see the graph."""
    if ros == "1":
        alone = options.deploy_ros_master is False and options.ros_master_uri is None
        return NO_MASTER if alone else None
    return ZENOH if speaks_zenoh(options, ros) else None


def speaks_zenoh(options: OrchestrationOptions, ros: Ros) -> bool:
    """Return whether nodes use zenoh, whose discovery cannot be read."""
    middleware = options.middleware or mode_of(options.network).middleware
    return ros != "1" and middleware == "zenoh"


def check_exporter(options: OrchestrationOptions, ros: Ros) -> Iterator[Problem]:
    """Yield what hides the graph from the exporter, and what has the exporter's name."""
    wanted = options.observability
    if wanted.exporter is None:
        return
    if why := reason(options, ros):
        if wanted.ros_metrics:
            yield Problem(("observability", "ros_metrics"), why, "no-ros-metrics", at_key=True)
        else:
            path = ("observability",)
            yield Problem(path, why, "no-ros-metrics", severity="warning", at_key=True)
    for key in options.nodes:
        if object_name(str(key)) == EXPORTER:
            message = f'"{EXPORTER}" is the name of the exporter of ros_metrics: choose another'
            yield Problem(("nodes", str(key)), message, "name-taken", at_key=True)
