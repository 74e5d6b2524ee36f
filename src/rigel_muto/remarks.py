"""Reports about a value of a stack, at its place."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import attrs

from rigel_k8s.problems import Path
from rigel_k8s.rigelfile.findings import Finding, make_finding, name_nearest
from rigel_k8s.rigelfile.source import YamlNode


@attrs.frozen
class Remark:
    """A finding about a stack.

    Attributes:
        lost: something of the stack is not carried over; an error where the user is strict.
        node: the key of the node that it is about; None: the stack as a whole.
        option: the path of the node's option, or the job's, that would replace what is lost.
    """

    finding: Finding
    lost: bool = False
    node: str | None = None
    option: Path = ()


class NotFound(Exception):
    """A stack does not exist; the text says so."""


class Unreadable(Exception):
    """A value that cannot be used; the remark has the reason."""

    def __init__(self, remark: Remark) -> None:
        super().__init__(remark.finding.message)
        self.remark = remark


def error(at: YamlNode, message: str, kind: str, *, key: bool = False) -> Remark:
    """Return a reason why the stack cannot be deployed."""
    return Remark(make_finding(at, message, kind, key=key))


def note(at: YamlNode, message: str, kind: str, *, key: bool = False) -> Remark:
    """Return a note on something that works differently from how it looks."""
    finding = make_finding(at, message, kind, key=key)
    return Remark(attrs.evolve(finding, severity="warning"))


def loss(
    at: YamlNode,
    message: str,
    *,
    kind: str = "not-carried",
    node: str | None = None,
    option: Path = (),
) -> Remark:
    """Return what of a stack is not carried over: shown at its key, if it has one."""
    remark = note(at, message, kind, key=True)
    return attrs.evolve(remark, lost=True, node=node, option=option)


def describe_unknown(key: str, what: str, known: Iterable[str]) -> str:
    """Return the message about a key without a meaning; `what` has it: "a node"."""
    return f'unknown key "{key}" of {what} is not carried over{name_nearest(key, known)}'


def list_findings(remarks: Iterable[Remark], *, strict: bool) -> Iterator[Finding]:
    """Yield the findings; `strict` makes errors of what is lost."""
    for remark in remarks:
        if strict and remark.lost:
            yield attrs.evolve(remark.finding, severity="error")
        else:
            yield remark.finding


def leave_out_replaced(
    remarks: Iterable[Remark], job: YamlNode, nodes: Mapping[str, YamlNode]
) -> Iterator[Remark]:
    """Yield the remarks without losses that the Rigelfile replaces: in the job, or its `nodes`."""
    for remark in remarks:
        own = job if remark.node is None else nodes.get(remark.node)
        if not (remark.lost and remark.option and own and has_path(own, remark.option)):
            yield remark


def has_path(node: YamlNode, path: Path) -> bool:
    """Return whether keys lead from a value to another one."""
    for key in path:
        if not isinstance(node.value, dict) or key not in node.value:
            return False
        node = node.value[str(key)]
    return True
