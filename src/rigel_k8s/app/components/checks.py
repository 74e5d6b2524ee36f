"""What is wrong with the components of a node; paths are the node's own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rigel_k8s.app.components.options import Component
from rigel_k8s.app.components.running import dotted
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.parameters import is_list_of_one_type
from rigel_k8s.app.programs import find_program, takes_ros_arguments
from rigel_k8s.app.ros1commands import full_name
from rigel_k8s.app.updating import is_rolling
from rigel_k8s.objects.naming import Ros
from rigel_k8s.objects.scalars import RosName
from rigel_k8s.problems import Path, Problem


def check_components(key: str, node: NodeOptions, ros: Ros) -> Iterator[Problem]:
    """Yield what is wrong with the components of the node of a key."""
    if not node.components:
        return
    if reason := explain_no_loading(node, ros):
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
        for problem in check_component(name, component, ros):
            yield problem.under(path)


def explain_no_loading(node: NodeOptions, ros: Ros) -> str | None:
    """Return why nothing can be loaded into a node, None if it can."""
    if ros == "none":
        return "only a ROS node loads components"
    if node.launch:
        return "a launch file loads its components itself: remove `launch` or `components`"
    if node.anonymous:
        return "components are loaded by the node's name, but an anonymous node's name is unknown"
    if ros == "2" and is_rolling(node.update):
        return "in a rolling update the containers of both pods would load them: use Recreate"
    line = find_program(ros, node)
    if line and not takes_ros_arguments(ros, line):
        return f"{line[0]} does not pass on the node's name, by which components are loaded"
    return None


def check_component(key: str, component: Component, ros: Ros) -> Iterator[Problem]:
    """Yield what is wrong with one component; paths are its own."""
    if component.name is None:
        try:
            RosName.parse(key)
        except ValueError as error:
            yield Problem((), f"{error}, or set a `name`", RosName.kind, at_key=True)
    if ros == "2" and component.package is None:
        message = f"the package of {component.plugin} is missing: add `package`"
        yield Problem((), message, "incomplete", at_key=True)
    if ros == "1":
        for name in ("package", "extra_arguments"):
            if getattr(component, name):
                message = f"a nodelet has no {name}: write its plugin as PACKAGE/CLASS"
                yield Problem((name,), message, "not-ros1", at_key=True)
    for name, value in component.parameters.items():
        if reason := explain_unfit({name: value}, ros):
            yield Problem(("parameters", name), reason, "bad-parameter", at_key=True)


def explain_unfit(parameters: dict[str, Any], ros: Ros) -> str | None:
    """Return why parameters cannot be passed to a component, None if they can."""
    for name, value in dotted(parameters):
        if value is None:
            return f'the parameter "{name}" has no value'
        if ros == "2" and isinstance(value, list) and not (value and is_list_of_one_type(value)):
            return f'the list "{name}" must have values of one type, and at least one'
    return None
