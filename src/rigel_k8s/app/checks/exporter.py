"""What keeps an application from having the ROS exporter that is asked for; pure."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.naming import Ros, object_name
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.problems import Problem

ZENOH = (
    "ros_metrics: the exporter joins DDS and speaks no zenoh, so this application has no metrics of"
    " its ROS graph; set `ros_metrics: false` to turn this warning off"
)
NO_MASTER = (
    "ros_metrics: without a ROS master that others reach there is no graph to be seen: give"
    " ros_master_uri or leave deploy_ros_master out, or say `ros_metrics: false`"
)


def can_be_seen(options: OrchestrationOptions, ros: Ros) -> bool:
    """Return whether an exporter could see the application's graph."""
    return reason(options, ros) is None


def reason(options: OrchestrationOptions, ros: Ros) -> str | None:
    """Return why an exporter would see nothing, None where it would."""
    if ros == "1":
        alone = options.deploy_ros_master is False and options.ros_master_uri is None
        return NO_MASTER if alone else None
    return ZENOH if speaks_zenoh(options, ros) else None


def speaks_zenoh(options: OrchestrationOptions, ros: Ros) -> bool:
    """Return whether nodes use zenoh, whose discovery cannot be read."""
    middleware = options.middleware or mode_of(options.network).middleware
    return ros != "1" and middleware == "zenoh"


def check_exporter(options: OrchestrationOptions, ros: Ros) -> Iterator[Problem]:
    """Yield what keeps the exporter from seeing the graph, and who has its name."""
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
