"""What a ROS 1 container runs: a program with ROS' own arguments, rosrun, roslaunch; its
parameters, and nodelets: components that a node's manager loads.

An image's ENTRYPOINT sets up ROS, so what runs is in `args` unless the user wrote `command`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, datetime
from pathlib import PurePosixPath
from typing import Any

import yaml

from rigel_k8s.app.command import Command
from rigel_k8s.app.generation import Loading
from rigel_k8s.app.options import Component, NodeOptions
from rigel_k8s.app.parameters import (
    PARAMETERS_PATH,
    Fault,
    FileLoader,
    ParameterOptions,
    flat,
    flat_values,
    list_local,
    tree,
)
from rigel_k8s.app.programs import (
    NO_ROS_ARGUMENTS,
    assignments,
    begin,
    full_name,
    list_steps,
    needs_script,
    split,
    write_values,
)
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.objects.overlay import simplify
from rigel_k8s.option_text import text_of
from rigel_k8s.problems import Problem

#: What loads nodelets if a node has components and no program.
MANAGER = ("rosrun", "nodelet", "nodelet", "manager")

#: Loads the parameter files into $0, then becomes the program. The master may not run yet.
LOADER = f"""\
command -v rosparam >/dev/null || {{
  echo "no rosparam in PATH, so parameters cannot be loaded; is ROS set up?" >&2; exit 127; }}
for file in {PARAMETERS_PATH}/*.yaml; do
  until rosparam load "$file" "$0"; do sleep 1; done
done
exec "$@"
"""


def takes_arguments(line: Sequence[str]) -> bool:
    """Return whether `name:=value` can be appended to a command line."""
    return bool(line) and PurePosixPath(line[0]).name not in NO_ROS_ARGUMENTS


def command_of(key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
    """Return what a node's container runs.

    Args:
        key: the node's key in `nodes`.
        files: the texts of its parameter files, by the names in `parameter_files`.
    """
    line = [*program(node), *ros_arguments(key, node)]
    if not line:
        return Command()
    mounted = parameter_files(node, files)
    start: tuple[str, ...] = ()
    if needs_script(node):
        steps = [] if node.anonymous else list_steps(node, parameter_namespace(key, node))
        start = (*begin("ros1", node, node.env), *steps)
    elif mounted:
        line = ["/bin/sh", "-c", LOADER, parameter_namespace(key, node), *line]
    if node.command is not None:
        return Command(command=line, files=mounted, start=start)
    return Command(args=line, files=mounted, start=start)


def program(node: NodeOptions) -> list[str]:
    """Return the program and its own arguments; empty for the image's CMD."""
    own = split(node, node.args or [])
    if node.launch:
        # Without --wait it ends at once if the master does not run yet.
        package = [node.launch.package] if node.launch.package else []
        return ["roslaunch", "--wait", *package, node.launch.file, *assignments(node.launch.args)]
    if node.package:
        return ["rosrun", node.package, node.executable or "", *own]
    line = split(node, node.command) if node.command is not None else own
    return line or list(MANAGER if node.components else ())


def ros_arguments(key: str, node: NodeOptions) -> Iterator[str]:
    """Yield what ROS reads of a command line: the name, remappings, private parameters."""
    if node.launch or not takes_arguments(program(node)):
        return
    if not node.anonymous:
        yield f"__name:={full_name(key, node).rpartition('/')[2]}"
    yield from assignments(node.remappings)
    if not needs_file(node):
        for name, value in flat(node.parameters):
            yield f"_{name}:={scalar(value)}"


def scalar(value: Any) -> str:
    """Return a parameter's text; rospy reads it as YAML."""
    if isinstance(value, str | int | float) and not reads_otherwise(value):
        return text_of(value)
    dumped: str = yaml.safe_dump(simplify(value), default_flow_style=True, width=2**20)
    return dumped.removesuffix("\n...\n").strip()


def reads_otherwise(value: Any) -> bool:
    """Return whether rospy or roscpp would read a parameter's text as something else."""
    if isinstance(value, bool | int | float):
        return False
    if not isinstance(value, str):
        return True
    try:
        float(value)
    except ValueError:
        pass
    else:
        return True
    try:
        return bool(yaml.safe_load(value) != value)
    except yaml.YAMLError:
        return True


def needs_file(node: NodeOptions) -> bool:
    """Return whether a node's parameters are loaded from files before it starts.

    So are those that a command line cannot carry: roscpp cannot read a list from it, and reads text
    that looks like a number as a number. Nothing can be loaded for a name generated at the start.
    """
    if needs_script(node):
        return not node.anonymous
    if node.anonymous or node.launch:
        return bool(node.parameter_files) and not node.anonymous
    return bool(node.parameter_files) or any(
        reads_otherwise(value) for _, value in flat(node.parameters)
    )


def parameter_namespace(key: str, node: NodeOptions) -> str:
    """Return where parameter files are loaded: the node's own name; a launch file's namespace."""
    if node.launch:
        return ros_name((node.namespace or "/").strip("/") or "/")
    return full_name(key, node)


def parameter_files(node: NodeOptions, files: Mapping[str, str]) -> dict[str, str]:
    """Return the files to mount, in the order of loading; `parameters` win over files."""
    if not needs_file(node):
        return {}
    found = {name: files[path] for name, path in list_local(node)}
    if node.parameters and needs_script(node):
        found |= write_values(tree(node.parameters))
    elif node.parameters:
        found["99-parameters.yaml"] = yaml.safe_dump(tree(node.parameters), sort_keys=True)
    return found


def describe_nodelet(key: str, component: Component) -> dict[str, Any]:
    """Return a nodelet for nodelets.py: full names, nested parameters."""
    name = component.full_name(key)
    namespace = name.rpartition("/")[0]
    return {
        "name": name,
        "plugin": component.plugin,
        "parameters": tree(component.parameters),
        "remappings": {
            resolve(str(one), name, namespace): resolve(str(other), name, namespace)
            for one, other in component.remappings.items()
        },
    }


def resolve(name: str, node: str, namespace: str) -> str:
    """Return the full name of a ROS name in a node."""
    if name.startswith("/"):
        return name
    return f"{node}/{name[1:].lstrip('/')}" if name.startswith("~") else f"{namespace}/{name}"


def check_nodelet(component: Component) -> Iterator[Problem]:
    for name in ("package", "extra_arguments"):
        if getattr(component, name):
            message = f"a nodelet has no {name}: write its plugin as PACKAGE/CLASS"
            yield Problem((name,), message, "not-ros1", at_key=True)
    yield from check_values(component)


def check_values(options: ParameterOptions | Component) -> Iterator[Problem]:
    """Yield parameters that XML-RPC does not carry to the master; paths are their own."""
    for key, name, value in flat_values(options.parameters):
        if reason := explain_xmlrpc_value(value):
            message = f'the parameter "{name}" {reason}'
            yield Problem(("parameters", key), message, "bad-parameter", at_key=True)


def check_parameter_file(text: str, key: str | None, options: ParameterOptions) -> Iterator[Fault]:
    """Yield the values of a file that rosparam could not load."""
    content = yaml.load(text, FileLoader)
    if "ros__parameters" in json.dumps(content, default=str):
        yield Fault("ROS 1 reads ros__parameters as a part of names: leave it out", ends=False)
    for name, value in content.items():
        if reason := explain_xmlrpc_value(value):
            yield Fault(f'the parameter "{name}" {reason}')


def explain_xmlrpc_value(value: Any) -> str | None:
    """Return why a value is none of XML-RPC, None if it is one."""
    if isinstance(value, date) and not isinstance(value, datetime):
        return f"is a date: write '{value}'"
    if value is None:
        return "has no value"
    if isinstance(value, list | tuple):
        return next(filter(None, map(explain_xmlrpc_value, value)), None)
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            return "has a key that is no text: write it in quotes"
        return next(filter(None, map(explain_xmlrpc_value, value.values())), None)
    if isinstance(value, int) and not -(2**31) <= value < 2**31:
        return f"is {value}, and ROS 1 has numbers of 32 bits: write {value}.0, or a text"
    return None


NODELETS = Loading(
    script="nodelets.py", describe=describe_nodelet, check=check_nodelet, are_nodes=False
)
