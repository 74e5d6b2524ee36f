"""DDS without ROS: programs that find each other by DDS, without ROS' names and arguments."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.app.generations import masterless
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import Command
from rigel_k8s.app.updating import recreate
from rigel_k8s.generation import Generation
from rigel_k8s.network.modes import ready_words
from rigel_k8s.objects.text import split_words


def program(node: NodeOptions) -> list[str]:
    """Return the program and its own arguments; empty for the image's CMD."""
    return split_words(node.command if node.command is not None else node.args or [])


def command_of(key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
    """Return what a container runs: what the user wrote."""
    if node.command is not None:
        return Command(command=split_words(node.command))
    return Command(args=split_words(node.args) if node.args is not None else None)


DDS = Generation(
    name="none",
    title="a plain DDS application",
    nodes=False,
    readiness="none",
    program=program,
    command_of=command_of,
    probe=ready_words,
    find_obstacle=lambda *_: None,
    choose_way=recreate,
    refuse_hand_over=lambda *_: "it has no ROS: use Recreate or Rolling",
    check=lambda options: masterless.check(options, "a plain DDS application"),
    explain_unseen=masterless.explain_unseen,
    read_graph=masterless.read_graph,
)
