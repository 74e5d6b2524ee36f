"""What a container runs, before its generation of ROS adds arguments: lines, and scripts beside."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.generation import Generation
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.option_text import text_of

SHELLS = ("sh", "bash", "dash", "ash", "zsh")
#: Programs that would misread an argument of ROS, or do not pass it on.
NO_ROS_ARGUMENTS = frozenset(
    (*SHELLS, "busybox", "env")
    + ("roslaunch", "roscore", "rosmaster", "sleep", "tail", "true", "cat")
)


@attrs.frozen
class Command:
    """A container's command and args (None: the image's own), and its parameter files.

    Attributes:
        files: name to text, to be mounted at PARAMETERS_PATH.
        start: the words of start.sh, which `put_start_before` puts before all others; empty
            if there is nothing to prepare.
    """

    command: Sequence[str] | None = None
    args: Sequence[str] | None = None
    files: Mapping[str, str] = attrs.field(factory=dict)
    start: Sequence[str] = ()


def full_name(key: str, node: NodeOptions) -> str:
    """Return the full ROS name of a node."""
    return ros_name(node.name or key, node.namespace)


def assignments(pairs: Mapping[Any, Any]) -> Iterator[str]:
    """Yield `name:=value` for each pair."""
    return (f"{name}:={text_of(value)}" for name, value in pairs.items())


def find_program(ros: Generation, node: NodeOptions) -> list[str]:
    """Return what a node runs; empty for an invalid command line, which others report."""
    try:
        return ros.program(node)
    except ValueError:
        return []


def run_beside(command: Command, *words: str) -> Command:
    """Return a command with an in-pod script that runs next to it; see rigel_inpod/README.md."""
    return wrap(command, "beside.sh", *words, "--")


def put_start_before(command: Command) -> Command:
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


def explain_not_passed(line: Sequence[str], key: str) -> str:
    """Return that a program does not pass an option on to the node that it starts."""
    return f"{line[0]} does not pass {key} on to the node: use args with the node's program"
