"""What a ROS 2 container runs: --ros-args with names, remappings and parameter files.

Parameters always travel in files: on a command line "1.10" would become a number, and lists need
quoting that shells and launch files undo.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

import yaml

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH, list_local, list_paths, unify_lists
from rigel_k8s.app.ros1commands import NO_ROS_ARGUMENTS, Command, assignments, full_name
from rigel_k8s.app.starting import (
    begin,
    list_run_steps,
    load_values,
    needs_script,
    split,
    write_values,
)
from rigel_k8s.substitution_args import has_substitution
from rigel_k8s.yaml_text import Dumper, Loader

FLAG, END = "--ros-args", "--"
#: The parameters of all nodes of a process.
ANY_NODE = "/**"
PARAMETERS = "ros__parameters"
#: What loads components if a node has no program of its own.
CONTAINER = ("ros2", "run", "rclcpp_components", "component_container")
#: The node's own `parameters`, as rcl reads them.
OWN_FILE = "99-parameters.yaml"


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
    start: tuple[str, ...] = ()
    if needs_script(node):
        steps = (*load_values(mounted, ANY_NODE), *list_run_steps(node))
        start = (*begin("2", node, node.env), *steps)
    if node.command is not None:
        return Command(command=line, files=mounted, start=start)
    return Command(args=line, files=mounted, start=start)


def program(node: NodeOptions) -> list[str]:
    """Return the program and its own arguments; empty for the image's CMD."""
    own = split(node, node.args or [])
    if node.launch:
        package = [node.launch.package] if node.launch.package else []
        return ["ros2", "launch", *package, node.launch.file, *assignments(node.launch.args)]
    if node.package:
        return ["ros2", "run", node.package, node.executable or "", *own]
    line = split(node, node.command) if node.command is not None else own
    return line or list(CONTAINER if node.components else ())


def ros_arguments(
    key: str, node: NodeOptions, line: Sequence[str], mounted: Mapping[str, str]
) -> list[str]:
    """Return what is appended to a line for ROS: names, remappings, parameter files."""
    if node.launch or not takes_ros_arguments(line):
        return []
    found = [word for rule in rules(key, node) for word in ("-r", rule)]
    paths = [path for path, _ in list_paths(node)]
    if OWN_FILE in mounted:
        paths.append(f"{PARAMETERS_PATH}/{OWN_FILE}")
    found += [word for path in paths for word in ("--params-file", path)]
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
    """Return whether the end of a line is already read as ROS arguments."""
    marks = [word for word in line if word in (FLAG, END)]
    return marks[-1:] == [FLAG]


def render_files(node: NodeOptions, files: Mapping[str, str]) -> dict[str, str]:
    """Return the files to mount, in the order of loading; `parameters` win over files."""
    found = {name: nest_parameters(files[path]) for name, path in list_local(node)}
    later = {
        name: value
        for name, value in node.parameters.items()
        if node.substitution_args and has_substitution(value)
    }
    now = {name: value for name, value in node.parameters.items() if name not in later}
    if now:
        own = {ANY_NODE: {PARAMETERS: quote_texts(unify_lists(now))}}
        found[OWN_FILE] = yaml.dump(own, Dumper=ParameterDumper, sort_keys=True, width=2**20)
    if later:
        found |= write_values(unify_lists(later))
    return found


class QuotedText(str):
    """A text that is written in quotes."""


class ParameterDumper(Dumper):  # type: ignore[misc]  # Any: with or without LibYAML
    """Writes YAML for rcl."""


ParameterDumper.add_representer(
    QuotedText,
    lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", str(text), style='"'),
)


def quote_texts(value: Any) -> Any:
    """Return parameters whose texts are quoted: rcl reads `y` and `12e5` as other types."""
    if isinstance(value, str):
        return QuotedText(value)
    if isinstance(value, Mapping):
        return {key: quote_texts(inner) for key, inner in value.items()}
    return [quote_texts(inner) for inner in value] if isinstance(value, list) else value


def nest_parameters(text: str) -> str:
    """Return a parameter file as rcl reads it; plain names and values apply to any node.

    The text itself is kept: rcl reads 1e3 as a number, our YAML parser as text.
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
