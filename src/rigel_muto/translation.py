"""A stack with all that it refers to as `nodes` of a job."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import attrs

from rigel_k8s.problems import Path
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.rigelfile.limits import LONGEST_CHAIN
from rigel_k8s.rigelfile.source import YamlNode, node_of
from rigel_muto.arguments import Allowance, Arguments, Completion
from rigel_muto.composed import (
    COMPONENTS,
    add_components,
    find_loader,
    simplify_manager,
    translate_container,
    translate_nodelet,
)
from rigel_muto.nodes import Translated, translate_node
from rigel_muto.parameters import Parameters, merge
from rigel_muto.remarks import NotFound, Remark, Unreadable, error, loss, note
from rigel_muto.stack import Stack, is_empty, text_at

NO_MANAGER = (
    'this nodelet is not carried over into one pod with its manager: no node of the stack is "{}"'
)
GLOBAL = (
    "parameters of the whole stack are not carried over, as ROS 2 has no global parameters: write"
    " them as `parameters` or `parameter_files` of the nodes that read them"
)
BUILD = (
    "this stack is an archive with sources, which needs a build: `rigel muto convert STACK --to"
    " DIRECTORY` writes its sources and a Rigelfile that builds and deploys them"
)
NO_RESPAWN = (
    "Kubernetes starts a node again whenever it ends; this holds for each node with"
    " `respawn: false`"
)


@attrs.frozen
class Translation:
    """Nodes of a job, by key, and the remarks about them.

    Attributes:
        options: the job's options beside `nodes`: global parameters.
        ros2: whether the stacks are for ROS 2; None if nothing in them says so.
    """

    nodes: Mapping[str, YamlNode]
    remarks: tuple[Remark, ...]
    options: Mapping[str, YamlNode] = attrs.field(factory=dict)
    ros2: bool | None = None


def translate(
    stack: Stack,
    given: Mapping[str, str],
    find: Callable[[str], Stack],
    *,
    ros2: bool | None = None,
) -> Translation:
    """Return the nodes of a stack and of all that it refers to.

    Args:
        given: values of arguments; each must be declared by one of the stacks.
        find: returns the stack of an id, or raises NotFound or Unreadable.
        ros2: whether they are for ROS 2; None: as the stacks say.
    """
    gathering = Gathering(find)
    gathering.add(stack)
    if ros2 is None:
        ros2 = _find_ros2(gathering.stacks)
    work = _Work(given, ros2=bool(ros2))
    for one in gathering.stacks:
        work.add(one)
    work.join_nodelets()
    remarks = (*gathering.remarks, *work.list_remarks(), *work.list_unknown_arguments(stack))
    return Translation(work.nodes, remarks, work.options, ros2)


def _find_ros2(stacks: Sequence[Stack]) -> bool | None:
    """Return whether stacks are for ROS 2; None if nothing in them says so."""
    if any(stack.ros2 for stack in stacks):
        return True
    return False if any(stack.needs_ros1 for stack in stacks) else None


def require_nodes(stack: Stack, made: Translation) -> Translation:
    """Return a translation, with an error in it if it has no nodes and no error says why."""
    if made.nodes or any(remark.finding.severity == "error" for remark in made.remarks):
        return made
    missing = error(stack.place, "this stack has no node that can be run", "no-node")
    return attrs.evolve(made, remarks=(*made.remarks, missing))


class Gathering:
    """Collects stacks, each once; those that one refers to come before it.

    Args:
        find: returns the stack of an id, or raises NotFound or Unreadable.
    """

    def __init__(self, find: Callable[[str], Stack]) -> None:
        self.remarks: list[Remark] = []
        self.stacks: list[Stack] = []
        self._find = find
        self._open: list[Stack] = []

    def add(self, stack: Stack) -> None:
        """Add a stack and all that it refers to; what is wrong becomes a remark."""
        if any(known is stack for known in self.stacks):
            return
        self._open.append(stack)
        for part in stack.parts:
            self.add(part)
        for reference in stack.references:
            self._follow(reference)
        self._open.pop()
        self.remarks += stack.remarks
        self.stacks.append(stack)

    def _follow(self, reference: YamlNode) -> None:
        identifier = text_at(reference.value, "thingId") or text_at(reference.value, "stackId")
        if not identifier:
            message = "a reference to a stack needs a thingId"
            self.remarks.append(error(reference, message, "missing-key"))
            return
        if chain := list(self._list_chain(identifier)):
            message = f"this stack refers to itself: {' -> '.join([*chain, identifier])}"
            self.remarks.append(error(reference, message, "stack-cycle"))
            return
        if len(self._open) > LONGEST_CHAIN:
            message = f"more than {LONGEST_CHAIN} stacks refer to each other"
            self.remarks.append(error(reference, message, "too-large"))
            return
        try:
            self.add(self._find(identifier))
        except NotFound as fault:
            self.remarks.append(error(reference, str(fault), "unknown-stack"))
        except Unreadable as fault:
            self.remarks.append(fault.remark)

    def _list_chain(self, identifier: str) -> Iterator[str]:
        """Yield the open stacks from the one of an id on; nothing where it is not open."""
        inside = False
        for stack in self._open:
            if identifier in stack.ids:
                inside = True
                yield identifier
            elif inside:
                yield stack.label


class _Work:
    """The nodes so far."""

    def __init__(self, given: Mapping[str, str], *, ros2: bool) -> None:
        self.nodes: dict[str, YamlNode] = {}
        self.options: dict[str, YamlNode] = {}
        self._ros2 = ros2
        self._remarks: list[Remark] = []
        self._of_nodes: dict[str, tuple[Remark, ...]] = {}
        self._given = given
        self._allowance = Allowance()
        self._declared: set[str] = set()
        self._reported_respawn = False
        self._sources: dict[str, tuple[YamlNode, Arguments]] = {}

    def add(self, stack: Stack) -> None:
        """Lay a stack's nodes over the existing ones."""
        arguments = Arguments(stack.arguments, self._given, self._allowance)
        self._remarks += arguments.remarks
        self._declared |= arguments.names
        if stack.archive:
            self._remarks.append(error(stack.archive.place, BUILD, "needs-build", key=True))
        if self._ros2:
            self._remarks += [loss(entry, GLOBAL) for entry in stack.parameters]
        else:
            self._add_parameters(stack, arguments)
        for entry in stack.containers:
            self._add(entry, translate_container(entry, arguments))
        for entry in stack.nodes:
            translated = translate_node(entry, arguments)
            self._add(entry, translated)
            if translated.options is not None:
                self._sources[translated.key] = (entry, arguments)

    def _add_parameters(self, stack: Stack, arguments: Arguments) -> None:
        def lose(at: YamlNode, message: str, option: Path, kind: str) -> None:
            advice = f"; set {'.'.join(map(str, option))} in the Rigelfile" if option else ""
            self._remarks.append(loss(at, message + advice, kind=kind, option=option))

        completion = Completion(arguments, lose)
        parameters = Parameters(completion, whole=True)
        for entry in stack.parameters:
            try:
                parameters.add(entry)
            except Unreadable as fault:
                self._remarks.append(fault.remark)
        if stack.parameters:
            at = stack.parameters[0]
            self.options = merge(self.options, parameters.options(at))
            if completion.substitutes:
                self.options["substitution_args"] = node_of(True, at)

    def _add(self, entry: YamlNode, translated: Translated) -> None:
        if translated.options is None:
            self._remarks += translated.remarks
            return
        if translated.key in self.nodes:
            message = f'the node "{translated.key}" already exists: this one replaces it'
            self._remarks.append(note(entry, message, "duplicate-node"))
        self.nodes[translated.key] = translated.options
        self._of_nodes[translated.key] = translated.remarks
        self._remark_on_respawn(entry)

    def _remark_on_respawn(self, entry: YamlNode) -> None:
        respawn = entry.value.get("respawn")
        if respawn is None or is_empty(respawn) or self._reported_respawn:
            return
        if respawn.value is False or text_at(entry.value, "respawn").lower() in ("false", "0"):
            self._reported_respawn = True
            self._remarks.append(loss(respawn, NO_RESPAWN))

    def join_nodelets(self) -> None:
        """Turn nodes that only load a nodelet into components of their managers."""
        for key, options in list(self.nodes.items()):
            loader = find_loader(key, options)
            if loader is None:
                continue
            manager = self.nodes.get(loader.manager)
            if manager is None or find_loader(loader.manager, manager):
                message = NO_MANAGER.format(loader.manager)
                self._remarks.append(loss(options.value["args"], message, node=key))
                continue
            made = translate_nodelet(*self._sources[key], loader)
            assert made.options is not None, "it was translated before"
            del self.nodes[key]
            self.nodes[loader.manager] = add_components(manager, {key: made.options})
            del self._of_nodes[key]
            self._of_nodes[loader.manager] += made.remarks
        for key, options in self.nodes.items():
            if COMPONENTS in options.value:
                self.nodes[key] = simplify_manager(options)

    def list_remarks(self) -> Iterator[Remark]:
        """Yield the remarks; none about nodes that others have replaced."""
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
