"""param: parameters of a running node, by its services or at the master."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_graph import ros1
from rigel_graph.commands.live import Live, open_live
from rigel_graph.tools import CannotRun
from rigel_graph.types import GraphNode
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.rigelfile import name_nearest
from rigel_k8s.settings import Settings


@attrs.frozen
class Parameters:
    """Parameters of a node.

    Attributes:
        node: its ROS name.
        values: by name, sorted.
        key: its name in the Rigelfile, "" if it has none.
        effect: what a value that was set does.
    """

    node: str
    values: Mapping[str, Any]
    key: str = ""
    effect: str = "lasts until the node starts again"


def get_parameters(
    settings: Settings, node: str, names: Sequence[str], job: str | None = None
) -> Parameters:
    """Return some parameters of a node, or all. Raises as read_parameters."""
    found = release(settings, job, [node])
    with found.cluster:
        return read_parameters(found, node, names)


def read_parameters(found: Release, node: str, names: Sequence[str]) -> Parameters:
    """Return some parameters of a node of a release that is connected, or all.

    Raises:
        UserError: there is no such node or parameter.
        ClusterError: the node does not answer.
    """
    live = open_live(found)
    its = live.find_node(node)
    if live.generation == "1":
        values = read_ros1(found, its.name, names)
    else:
        answer = call(live, its, "get", dict.fromkeys(names))
        check_names(its.name, names, answer["names"])
        values = dict(answer["values"])
    return Parameters(its.name, values)


def set_parameters(
    settings: Settings, node: str, values: Mapping[str, Any], job: str | None = None
) -> Parameters:
    """Set parameters of a node, all or none. Raises as read_parameters, and if it refuses."""
    found = release(settings, job, [node])
    with found.cluster:
        live = open_live(found)
        its = live.find_node(node)
        key = next((pod.node for pod in live.pods if pod.workload == its.workload), "")
        if live.generation == "1":
            full = {full_name(its.name, name): value for name, value in values.items()}
            ros1.write_parameters(found.cluster, found.id, full)
            effect = "the ROS master has it; most ROS 1 nodes read it only when they start"
            return Parameters(its.name, values, key, effect)
        answer = call(live, its, "set", values)
        if answer["refused"] is not None:
            check_names(its.name, list(values), answer["names"])
            raise ClusterError(
                f"{its.name} refuses: {answer['refused']}",
                hint="no value was set" if len(values) > 1 else None,
            )
        return Parameters(its.name, values, key)


def call(live: Live, node: GraphNode, verb: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the answer of a node's parameter services."""
    request = {"do": verb, "node": node.name, "values": values}
    try:
        for answer in live.ask(request, [node.name], None, f"ros2 param list {node.name}"):
            return answer
    except ClusterError as error:
        if isinstance(error.__cause__, CannotRun) and error.__cause__.word in (
            "no-service",
            "no-answer",
        ):
            raise ClusterError(f"{node.name} {error.__cause__.text}") from error
        raise
    raise ClusterError(f"nothing of the parameters of {node.name} was answered")


def check_names(node: str, names: Sequence[str], known: Sequence[str]) -> None:
    """Raise UserError for a name that a node does not have."""
    for name in names:
        if name not in known:
            raise UserError(
                f'{node} has no parameter "{name}"{name_nearest(name, known)}',
                hint=f"its parameters are: {', '.join(known) or 'none'}",
            )


def full_name(node: str, name: str) -> str:
    """Return the name of a ROS 1 parameter; one with a leading / is global."""
    return name if name.startswith("/") else f"{node}/{name}"


def read_ros1(found: Release, node: str, names: Sequence[str]) -> dict[str, Any]:
    """Return ROS 1 parameters by name, without names all below the node's. Raises as above."""
    if not names:
        (tree,) = ros1.read_parameter(found.cluster, found.id, node) or ({},)
        return dict(sorted(flatten(tree)))
    values = {}
    for name in names:
        value = ros1.read_parameter(found.cluster, found.id, full_name(node, name))
        if not value:
            known = ros1.list_parameters(found.cluster, found.id)
            own = [one.removeprefix(f"{node}/") for one in known if one.startswith(f"{node}/")]
            check_names(node, [name], known if name.startswith("/") else own)
        values[name] = value[0]
    return values


def flatten(tree: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the names and values of ROS 1 parameters in a tree of namespaces."""
    for key, value in tree.items():
        if isinstance(value, dict) and value:
            yield from flatten(value, f"{above}{key}/")
        else:
            yield above + key, value
