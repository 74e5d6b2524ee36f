"""What a container runs, before its generation of ROS adds arguments: lines, and our scripts.

In-pod scripts run beside a program, or before it: start.sh fills in what only the container's image
has. Their contract is src/rigel_inpod/README.md.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Container, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.command import Command
from rigel_k8s.app.environment import Extra, entries
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH, ParameterOptions, file_of, list_paths
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.text import split_words
from rigel_k8s.option_text import text_of
from rigel_k8s.substitution_args import has_substitution, split_line

SHELLS = ("sh", "bash", "dash", "ash", "zsh")
#: Programs that would misread an argument of ROS, or do not pass it on.
NO_ROS_ARGUMENTS = frozenset(
    (*SHELLS, "busybox", "env")
    + ("roslaunch", "roscore", "rosmaster", "sleep", "tail", "true", "cat")
    + ("rosmsg", "rosnode", "rosparam", "rosservice", "rossrv")
)

#: Parameters as JSON, which the script reads; it is beside the mounted parameter files.
VALUES = "99-parameters.json"


def full_name(key: str, node: NodeOptions) -> str:
    return ros_name(node.name or key, node.namespace)


def assignments(pairs: Mapping[Any, Any]) -> Iterator[str]:
    """Yield `name:=value` for each pair."""
    return (f"{name}:={text_of(value)}" for name, value in pairs.items())


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


def needs_script(options: ParameterOptions) -> bool:
    """Return whether a container must be prepared by the script."""
    found = map(file_of, options.parameter_files)
    own = any(entry.image_file or entry.namespace for entry in found)
    return options.substitution_args or bool(options.parameter_commands) or own


def split(options: ParameterOptions, line: str | Sequence[Any]) -> list[str]:
    """Return a command line as a list; substitution args stay in one word (ValueError)."""
    together = options.substitution_args and isinstance(line, str)
    return split_line(str(line)) if together else split_words(line)


def begin(ros: str, options: ParameterOptions, env: Extra = ()) -> Iterator[str]:
    """Yield the first words: how parameters are loaded, ros1 or ros2, and what is substituted."""
    yield from ("/bin/sh", f"{SCRIPTS_PATH}/start.sh", ros)
    if options.substitution_args:
        yield "--substitute"
        for name, source in entries(env):
            if has_substitution(source.get("value")):
                yield from ("--env", name)


def list_steps(options: ParameterOptions, namespace: str) -> Iterator[str]:
    """Yield the words that set parameters of ROS 1 below a namespace."""
    above = namespace.rstrip("/")
    for path, below in list_paths(options):
        yield from ("--load", path, f"{above}/{below}".rstrip("/") or "/")
    if options.parameters:
        yield from load_values([VALUES], namespace)
    yield from list_run_steps(options, f"{above}/")


def load_values(mounted: Container[str], namespace: str) -> Iterator[str]:
    """Yield the words that read `write_values`' file, where it is mounted."""
    if VALUES in mounted:
        yield from ("--values", f"{PARAMETERS_PATH}/{VALUES}", namespace)


def list_run_steps(options: ParameterOptions, prefix: str = "") -> Iterator[str]:
    """Yield the words that run the commands of parameters."""
    for name, command in options.parameter_commands.items():
        line = shlex.join(split(options, command))
        yield from ("--run", f"{prefix}{str(name).lstrip('~/')}", line)


def write_values(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return the file with parameters of plain data, by its name."""
    return {VALUES: json.dumps(parameters, indent=1, sort_keys=True) + "\n"}
