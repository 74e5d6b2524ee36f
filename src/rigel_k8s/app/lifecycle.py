"""The transitions of a lifecycle node: a script next to it makes them, and the preStop hook.

Their contract is src/rigel_inpod/README.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rigel_k8s.app.command import Command
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import full_name, run_beside
from rigel_k8s.app.updating import is_rolling
from rigel_k8s.problems import Problem

STOP = "RIGEL_K8S_TRANSITIONS"


def make_transitions(command: Command, key: str, node: NodeOptions) -> Command:
    """Return a command that also runs the script that makes the transitions at the start."""
    if not node.lifecycle or not node.lifecycle.start:
        return command
    words = ("start", full_name(key, node), *node.lifecycle.start)
    return run_beside(command, "transitions.py", *words)


def list_variables(key: str, node: NodeOptions) -> Mapping[str, dict[str, str]]:
    """Return the variable that makes the preStop hook make the transitions at the end."""
    if not node.lifecycle or not node.lifecycle.stop:
        return {}
    return {STOP: {"value": " ".join([full_name(key, node), *node.lifecycle.stop])}}


def check_lifecycle(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong with the transitions of a node; paths are the node's own."""
    if node.lifecycle is None:
        return
    if not node.lifecycle.start and not node.lifecycle.stop:
        message = "no transitions: set `start`, as in start: [configure, activate], or `stop`"
        yield Problem(("lifecycle",), message, "incomplete", at_key=True)
    elif reason := explain_no_transitions(node, ros):
        yield Problem(("lifecycle",), reason, "lifecycle", at_key=True)


def explain_no_transitions(node: NodeOptions, ros: Generation) -> str | None:
    """Return why no transitions of a node can be made, None if they can."""
    line = ros.find_program(node)
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
    if not line and (node.args or node.command):
        return None  # it cannot be split, which is reported
    if not line:
        return "the image's CMD takes no ROS name: set what runs with args, or package"
    if not ros.takes_arguments(line):
        return f"{line[0]} does not pass on the node's name, by which its transitions are made"
    return None
