"""What a node's container runs, by its ROS version."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs

from rigel_k8s.app import ros1commands, ros2commands
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.ros1commands import Command
from rigel_k8s.objects.naming import Ros
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.text import split_words


def command_of(ros: Ros, key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
    """Return what a node's container runs; a plain DDS program gets no argument of ROS."""
    if ros == "2":
        return ros2commands.command_of(key, node, files)
    if ros == "1":
        return ros1commands.command_of(key, node, files)
    if node.command is not None:
        return Command(command=split_words(node.command))
    return Command(args=split_words(node.args) if node.args is not None else None)


def program(ros: Ros, node: NodeOptions) -> list[str]:
    """Return the program and its own arguments; empty for the image's CMD."""
    return ros2commands.program(node) if ros == "2" else ros1commands.program(node)


def find_program(ros: Ros, node: NodeOptions) -> list[str]:
    """Return what a node runs; empty for an invalid command line, which others report."""
    try:
        return program(ros, node)
    except ValueError:
        return []


def takes_ros_arguments(ros: Ros, line: Sequence[str]) -> bool:
    """Return whether names, remappings and parameters can be appended to a command line."""
    if ros == "2":
        return ros2commands.takes_ros_arguments(line)
    return ros == "1" and ros1commands.takes_ros_arguments(line)


def run_beside(command: Command, *words: str) -> Command:
    """Return a command with an in-pod script that runs next to it; see rigel_inpod/README.md."""
    return wrap(command, "beside.sh", *words, "--")


def run_by_lifecycle(command: Command) -> Command:
    """Return a command whose lifecycle node is handed over; see src/rigel_inpod/README.md."""
    return wrap(command, "lifecycle.sh")


def prepare(command: Command) -> Command:
    """Return a command that start.sh completes, before anything runs next to the node."""
    return put_before(command, *command.start, "--") if command.start else command


def wrap(command: Command, script: str, *words: str) -> Command:
    """Return a command that an in-pod script of sh starts."""
    return put_before(command, "/bin/sh", f"{SCRIPTS_PATH}/{script}", *words)


def put_before(command: Command, *before: str) -> Command:
    """Return a command with words in front of what the container runs."""
    if command.command is not None:
        return attrs.evolve(command, command=[*before, *command.command])
    return attrs.evolve(command, args=[*before, *(command.args or ())])
