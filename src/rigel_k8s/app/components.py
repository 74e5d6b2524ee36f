"""The components of a node, several ROS nodes in one process: a script next to it loads them.

The scripts' contract is src/rigel_inpod/README.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.app.command import Command
from rigel_k8s.app.generation import Generation, Loading
from rigel_k8s.app.options import Component, NodeOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH, unify_lists
from rigel_k8s.app.programs import full_name, run_beside
from rigel_k8s.app.updating import is_rolling
from rigel_k8s.objects.scalars import RosName
from rigel_k8s.problems import Path, Problem
from rigel_k8s.substitution_args import has_substitution

FILE = "components.json"


def load_components(
    command: Command, loading: Loading | None, key: str, node: NodeOptions
) -> Command:
    """Return a command that also runs the script that loads the node's components."""
    if not node.components or loading is None:
        return command
    plan = {
        "node": full_name(key, node),
        "components": [loading.describe(key, one) for key, one in node.components.items()],
    }
    files = {**command.files, FILE: json.dumps(plan, indent=1)}
    path = f"{PARAMETERS_PATH}/{FILE}"
    run = run_beside(command, loading.script, path)
    completes = node.substitution_args and has_substitution(plan)
    start = (*command.start, "--complete", path) if completes else command.start
    return attrs.evolve(run, files=files, start=start)


def dotted(parameters: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield ROS 2's names and values of nested parameters."""
    for name, value in parameters.items():
        if isinstance(value, Mapping) and value:
            yield from dotted(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", unify_lists(value)


def check_components(key: str, node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong with the components of the node of a key; paths are the node's own."""
    if not node.components:
        return
    loading = ros.components
    if loading is None:
        message = "only a ROS node loads components"
        yield Problem(("components",), message, "components", at_key=True)
        return
    if reason := explain_no_loading(node, ros, loading):
        yield Problem(("components",), reason, "components", at_key=True)
        return
    taken = {full_name(key, node): "the node itself"}
    for name, component in node.components.items():
        path: Path = ("components", name)
        full = component.full_name(name)
        if full in taken:
            message = f"{taken[full]} already has the ROS name {full}"
            yield Problem(path, message, "name-taken", at_key=True)
        taken.setdefault(full, f'"{name}"')
        for problem in check_component(name, component, ros, loading):
            yield problem.under(path)


def explain_no_loading(node: NodeOptions, ros: Generation, loading: Loading) -> str | None:
    """Return why nothing can be loaded into a node, None if it can."""
    if node.launch:
        return "a launch file loads its components itself: remove `launch` or `components`"
    if node.anonymous:
        return "components are loaded by the node's name, but an anonymous node's name is unknown"
    if loading.twice and is_rolling(node.update):
        return loading.twice
    line = ros.find_program(node)
    if line and not ros.takes_arguments(line):
        return f"{line[0]} does not pass on the node's name, by which components are loaded"
    return None


def check_component(
    key: str, component: Component, ros: Generation, loading: Loading
) -> Iterator[Problem]:
    """Yield what is wrong with one component; paths are its own."""
    if component.name is None:
        yield from check_key(key, ros)
    yield from check_ros_names(component, ros)
    yield from loading.check(component)


def check_key(key: str, ros: Generation) -> Iterator[Problem]:
    """Yield why a key cannot be the name of a node or component."""
    try:
        reason = ros.names.explain(ros.names.node, RosName.parse(key)) if ros.names else None
    except ValueError as error:
        reason = str(error)
    if reason:
        yield Problem((), f"{reason}, or set a `name`", RosName.kind, at_key=True)


def check_ros_names(options: NodeOptions | Component, ros: Generation) -> Iterator[Problem]:
    """Yield names and remappings that the generation does not have; paths are their own."""
    names = ros.names
    if names is None:
        return
    for key, name in (("name", options.name), ("namespace", options.namespace)):
        if name is not None and (reason := names.explain(names.node, str(name))):
            yield Problem((key,), reason, RosName.kind)
    for source, target in options.remappings.items():
        path: Path = ("remappings", str(source))
        if reason := names.explain(names.source, str(source)):
            yield Problem(path, reason, RosName.kind, at_key=True)
        if reason := names.explain(names.target, str(target)):
            yield Problem(path, reason, RosName.kind)
