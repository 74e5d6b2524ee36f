"""What is wrong with the components of a node; paths are the node's own."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.components.options import Component
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import find_program, full_name
from rigel_k8s.app.updating import is_rolling
from rigel_k8s.generation import Generation, Loading
from rigel_k8s.objects.scalars import RosName
from rigel_k8s.problems import Path, Problem


def check_components(key: str, node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong with the components of the node of a key."""
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
        for problem in check_component(name, component, loading):
            yield problem.under(path)


def explain_no_loading(node: NodeOptions, ros: Generation, loading: Loading) -> str | None:
    """Return why nothing can be loaded into a node, None if it can."""
    if node.launch:
        return "a launch file loads its components itself: remove `launch` or `components`"
    if node.anonymous:
        return "components are loaded by the node's name, but an anonymous node's name is unknown"
    if loading.twice and is_rolling(node.update):
        return loading.twice
    line = find_program(ros, node)
    if line and not ros.takes_arguments(line):
        return f"{line[0]} does not pass on the node's name, by which components are loaded"
    return None


def check_component(key: str, component: Component, loading: Loading) -> Iterator[Problem]:
    """Yield what is wrong with one component; paths are its own."""
    if component.name is None:
        try:
            RosName.parse(key)
        except ValueError as error:
            yield Problem((), f"{error}, or set a `name`", RosName.kind, at_key=True)
    yield from loading.check(component)
