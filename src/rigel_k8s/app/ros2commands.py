"""What a ROS 2 container runs: --ros-args with names, remappings and parameter files.

Parameters always travel in files: on a command line "1.10" would become a number, and lists need
quoting that shells and launch files undo.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

import attrs
import yaml

from rigel_k8s.app.commands import (
    NO_ROS_ARGUMENTS,
    PARAMETERS_PATH,
    Command,
    assignments,
    full_name,
    make_key,
)
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.objects.overlay import simplify
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.text import split_words
from rigel_k8s.yaml_text import Dumper, Loader

FLAG, END = "--ros-args", "--"
#: The parameters of whatever nodes a process has.
ANY_NODE = "/**"
PARAMETERS = "ros__parameters"


def takes_ros_arguments(line: Sequence[str]) -> bool:
    """Return whether --ros-args can be appended to a command line."""
    if not line:
        return False
    name = PurePosixPath(line[0]).name
    if name == "ros2":
        return list(line[1:2]) == ["run"]
    return name not in NO_ROS_ARGUMENTS


def command_of(key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
    """Return what a node's container runs.

    Args:
        key: the node's key in `nodes`.
        files: the texts of its parameter files, by the names in `parameter_files`.
    """
    mounted = render_files(node, files)
    line = program(node)
    line += ros_arguments(key, node, line, mounted)
    if not line:
        return Command()
    if node.command is not None:
        return Command(command=line, files=mounted)
    return Command(args=line, files=mounted)


def run_by_lifecycle(command: Command) -> Command:
    """Return a command whose lifecycle node is handed over; see docs/in-pod-scripts.md."""
    script = ["/bin/sh", f"{SCRIPTS_PATH}/lifecycle.sh"]
    if command.command is not None:
        return attrs.evolve(command, command=[*script, *command.command])
    return attrs.evolve(command, args=[*script, *(command.args or ())])


def program(node: NodeOptions) -> list[str]:
    """Return the program and its own arguments; empty for the image's CMD."""
    own = split_words(node.args or [])
    if node.launch:
        package = [node.launch.package] if node.launch.package else []
        return ["ros2", "launch", *package, node.launch.file, *assignments(node.launch.args)]
    if node.package:
        return ["ros2", "run", node.package, node.executable or "", *own]
    return split_words(node.command) if node.command is not None else own


def ros_arguments(
    key: str, node: NodeOptions, line: Sequence[str], mounted: Mapping[str, str]
) -> list[str]:
    """Return what is appended to a line for ROS: names, remappings, parameter files."""
    if node.launch or not takes_ros_arguments(line):
        return []
    found = [word for rule in rules(key, node) for word in ("-r", rule)]
    for name in mounted:
        found += ["--params-file", f"{PARAMETERS_PATH}/{name}"]
    if not found or reads_ros_arguments(line):
        return found
    return [FLAG, *found]


def rules(key: str, node: NodeOptions) -> Iterator[str]:
    """Yield remapping rules: the node's name and namespace, then the user's own."""
    namespace, _, name = full_name(key, node).rpartition("/")
    if node.anonymous:
        namespace = "/" + str(node.namespace or "").strip("/")
    else:
        yield f"__node:={name}"
    if namespace.strip("/"):
        yield f"__ns:={namespace}"
    yield from assignments(node.remappings)


def reads_ros_arguments(line: Sequence[str]) -> bool:
    """Return whether the end of a line is read as ROS arguments already."""
    marks = [word for word in line if word in (FLAG, END)]
    return marks[-1:] == [FLAG]


def render_files(node: NodeOptions, files: Mapping[str, str]) -> dict[str, str]:
    """Return the files to mount, in the order of loading; `parameters` win over files."""
    found = {
        f"{number:02}-{make_key(name)}.yaml": nest_parameters(files[name])
        for number, name in enumerate(node.parameter_files)
    }
    if node.parameters:
        own = {ANY_NODE: {PARAMETERS: simplify(node.parameters)}}
        found["99-parameters.yaml"] = yaml.dump(own, Dumper=Dumper, sort_keys=True, width=2**20)
    return found


def nest_parameters(text: str) -> str:
    """Return a parameter file as rcl reads it; one of plain names and values is for any node.

    The text itself is kept: rcl reads 1e3 as a number where this program's reader sees text.
    """
    if has_key(yaml.load(text, Loader), PARAMETERS):
        return text
    lines = (line for line in text.splitlines() if line.strip() not in ("---", "..."))
    body = textwrap.indent("\n".join(lines), "    ")
    return f"{ANY_NODE}:\n  {PARAMETERS}:\n{body}\n"


def has_key(value: Any, key: str) -> bool:
    """Return whether a tree of mappings has a key anywhere."""
    if not isinstance(value, Mapping):
        return False
    return key in value or any(has_key(item, key) for item in value.values())
