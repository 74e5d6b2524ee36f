"""A stack with all that it refers to as `nodes` of a job."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import attrs

from rigel_k8s.muto.arguments import Allowance, Arguments
from rigel_k8s.muto.gathering import Gathering
from rigel_k8s.muto.nodes import translate_node
from rigel_k8s.muto.remarks import Remark, error, loss, note
from rigel_k8s.muto.stack import Stack, is_empty, text_at
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.rigelfile.source import YamlNode

COMPOSABLE = (
    "composable nodes are not carried over: write a node with `launch` in the Rigelfile, whose"
    " launch file starts the container and loads them"
)
GLOBAL = (
    "parameters of the whole stack are not carried over: write them as `parameters` or"
    " `parameter_files` of the nodes that read them"
)
NO_RESPAWN = (
    "Kubernetes starts a node again whenever it ends; this holds for each node with"
    " `respawn: false`"
)


@attrs.frozen
class Translation:
    """Nodes of a job, by key, and what there is to say about them."""

    nodes: Mapping[str, YamlNode]
    remarks: tuple[Remark, ...]


def translate(stack: Stack, given: Mapping[str, str], find: Callable[[str], Stack]) -> Translation:
    """Return the nodes of a stack and of all that it refers to.

    Args:
        given: values of arguments; each must be declared by one of the stacks.
        find: returns the stack of an id, or raises NotFound or Unreadable.
    """
    gathering = Gathering(find)
    gathering.add(stack)
    work = _Work(given)
    for one in gathering.stacks:
        work.add(one)
    remarks = (*gathering.remarks, *work.list_remarks(), *work.list_unknown_arguments(stack))
    return Translation(work.nodes, remarks)


def require_nodes(stack: Stack, made: Translation) -> Translation:
    """Return a translation with an error in it where it has no nodes, and no error says why."""
    if made.nodes or any(remark.finding.severity == "error" for remark in made.remarks):
        return made
    missing = error(stack.place, "this stack has no node that can be run", "no-node")
    return attrs.evolve(made, remarks=(*made.remarks, missing))


class _Work:
    """The nodes so far."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self.nodes: dict[str, YamlNode] = {}
        self._remarks: list[Remark] = []
        self._of_nodes: dict[str, tuple[Remark, ...]] = {}
        self._given = given
        self._allowance = Allowance()
        self._declared: set[str] = set()
        self._told_respawn = False

    def add(self, stack: Stack) -> None:
        """Lay a stack's nodes over those that are there."""
        arguments = Arguments(stack.arguments, self._given, self._allowance)
        self._remarks += arguments.remarks
        self._declared |= arguments.names
        self._remarks += [loss(entry, GLOBAL) for entry in stack.parameters]
        self._remarks += [loss(entry, COMPOSABLE) for entry in stack.containers]
        for entry in stack.nodes:
            self._add_node(entry, arguments)

    def _add_node(self, entry: YamlNode, arguments: Arguments) -> None:
        translated = translate_node(entry, arguments)
        if translated.options is None:
            self._remarks += translated.remarks
            return
        if translated.key in self.nodes:
            message = f'the node "{translated.key}" is there already: this one replaces it'
            self._remarks.append(note(entry, message, "duplicate-node"))
        self.nodes[translated.key] = translated.options
        self._of_nodes[translated.key] = translated.remarks
        self._remark_on_respawn(entry)

    def _remark_on_respawn(self, entry: YamlNode) -> None:
        respawn = entry.value.get("respawn")
        if respawn is None or is_empty(respawn) or self._told_respawn:
            return
        if respawn.value is False or text_at(entry.value, "respawn").lower() in ("false", "0"):
            self._told_respawn = True
            self._remarks.append(loss(respawn, NO_RESPAWN))

    def list_remarks(self) -> Iterator[Remark]:
        """Yield what there is to say; nothing about nodes that others have replaced."""
        yield from self._remarks
        for remarks in self._of_nodes.values():
            yield from remarks

    def list_unknown_arguments(self, stack: Stack) -> Iterator[Remark]:
        """Yield the given arguments that no stack declares."""
        for name in self._given:
            if name not in self._declared:
                close = suggest(name, sorted(self._declared))
                message = f'no stack has the argument "{name}"{close}'
                yield error(stack.place, message, "unknown-argument")
