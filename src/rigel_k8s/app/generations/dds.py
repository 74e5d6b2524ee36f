"""DDS without ROS: programs that find each other by DDS, without ROS' names and arguments.

What ROS 2 shares with it is here, too: there is no master, and the graph is read from discovery.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import attrs

from rigel_k8s.app.command import Command
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import list_global_keys
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.text import split_words
from rigel_k8s.problems import Problem
from rigel_k8s.ros import NO_ROS

ZENOH = (
    "ros_metrics: without the library in its nodes the exporter supports DDS but not zenoh, so this"
    " application has no metrics of its graph; set `ros_metrics: false` to turn this warning off"
)


def check_masterless(options: OrchestrationOptions, title: str) -> Iterator[Problem]:
    """Yield options for a master in an application without one."""
    requested = {
        ("deploy_ros_master",): options.deploy_ros_master,
        ("ros_master_uri",): options.ros_master_uri,
        ("ros_master_image",): options.ros_master_image,
        ("ros_master_placement",): options.ros_master_placement.node_selector,
        ("additional_k8s_params", "ros_master"): options.additional_k8s_params.ros_master,
    }
    for path, value in requested.items():
        if value:
            message = f"{title} has no master: remove it; nodes find each other by `network`"
            yield Problem(path, message, "no-master-in-ros2", at_key=True)
    for key in list_global_keys(options):
        message = f"{title} has no global parameters: write them as {key} of the nodes"
        yield Problem((key,), message, "no-global-parameters", at_key=True)


def explain_zenoh(options: OrchestrationOptions) -> str | None:
    """Return why an exporter would see nothing: the discovery of zenoh cannot be read."""
    middleware = options.middleware or mode_of(options.network).middleware
    return ZENOH if middleware == "zenoh" else None


@attrs.frozen(kw_only=True)
class PlainDds(Generation):
    """Programs that use DDS and no ROS: what the user wrote runs, unchanged."""

    def program(self, node: NodeOptions) -> list[str]:
        """Return the program and its own arguments; empty for the image's CMD."""
        return split_words(node.command if node.command is not None else node.args or [])

    def command_of(self, key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
        """Return what a container runs: what the user wrote."""
        if node.command is not None:
            return Command(command=split_words(node.command))
        return Command(args=split_words(node.args) if node.args is not None else None)

    def refuse_hand_over(self, options: OrchestrationOptions, distro: str) -> str | None:
        """Return why nothing of a job can be handed over."""
        return "it has no ROS: use Recreate or Rolling"

    def check(self, options: OrchestrationOptions) -> Iterator[Problem]:
        """Yield options for a master, which it has not."""
        return check_masterless(options, self.title)

    def explain_unseen(self, options: OrchestrationOptions) -> str | None:
        """Return why an exporter would see nothing of the graph."""
        return explain_zenoh(options)


DDS = PlainDds.of(NO_ROS)
