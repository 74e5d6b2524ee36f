"""What is wrong with the lifecycle of a node; paths are the node's own."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import find_program
from rigel_k8s.app.updating import is_rolling
from rigel_k8s.generation import Generation
from rigel_k8s.problems import Problem


def check_lifecycle(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong with the transitions of a node."""
    if node.lifecycle is None:
        return
    if not node.lifecycle.start and not node.lifecycle.stop:
        message = "no transitions: set `start`, as in start: [configure, activate], or `stop`"
        yield Problem(("lifecycle",), message, "incomplete", at_key=True)
    elif reason := explain_no_transitions(node, ros):
        yield Problem(("lifecycle",), reason, "lifecycle", at_key=True)


def explain_no_transitions(node: NodeOptions, ros: Generation) -> str | None:
    """Return why no transitions of a node can be made, None if they can."""
    line = find_program(ros, node)
    if not ros.lifecycle:
        return "only ROS 2 has lifecycle nodes"
    if node.anonymous:
        return "transitions are made by the node's name, but an anonymous node's name is unknown"
    if node.launch:
        return "a launch file gives its nodes their names: use package and executable, or args"
    if node.components:
        return "a component container is not a lifecycle node"
    if is_rolling(node.update):
        return "in a rolling update the nodes of both pods would make them: use Recreate"
    if not line:
        return "the image's CMD takes no ROS name: set what runs with args, or package"
    if not ros.takes_arguments(line):
        return f"{line[0]} does not pass on the node's name, by which its transitions are made"
    return None
