"""The option `muto` of a job: its stack's nodes become the job's `nodes`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile.expansion import Expanded, Extension, Surroundings
from rigel_k8s.rigelfile.findings import Finding, find_nearest, make_finding, place
from rigel_k8s.rigelfile.source import YamlNode, lay_over, locate
from rigel_k8s.rigelfile.structure import structure
from rigel_k8s.system.trust import Untrusted, require_trust
from rigel_muto.opening import Find, Twin, open_stack
from rigel_muto.options import Muto
from rigel_muto.remarks import NotFound, Remark, Unreadable, leave_out_replaced, list_findings, note
from rigel_muto.stack import Stack
from rigel_muto.translation import Translation, require_nodes, translate

KEY, NODES = "muto", "nodes"
#: Options with which an entry of `nodes` is a node of its own.
PROGRAMS = frozenset(("package", "launch", "args", "command", "image"))


class NotAsked(Exception):
    """A stack is at another machine, which must not be queried now."""


def expand(node: YamlNode, surroundings: Surroundings) -> Expanded:
    """Return a job's options with the stack's nodes in place of `muto`."""
    written = node.value[KEY]
    rest = attrs.evolve(node, value={k: v for k, v in node.value.items() if k != KEY})
    if written.value is None and not written.hole:
        return Expanded(rest)
    unknown = attrs.evolve(written, value=None, raw=None, hole=True)
    waiting = attrs.evolve(rest, value={**rest.value, NODES: unknown})
    if written.has_hole() or surroundings.directory is None:
        return Expanded(waiting)
    found = structure(written, Muto | str)
    if found.value is None:
        return Expanded(waiting, tuple(place(written, problem) for problem in found.problems))
    try:
        options = Muto(stack=found.value) if isinstance(found.value, str) else found.value
    except ValueError as fault:
        return Expanded(waiting, (make_finding(written, str(fault), "bad-value"),))
    own = _entries_of(rest.value.get(NODES))
    translated = _translate(options, written, own, surroundings)
    if isinstance(translated, Finding):
        return Expanded(waiting, (translated,))
    remarks = leave_out_replaced(translated.remarks, node, own)
    findings = (
        *list_findings(remarks, strict=options.strict),
        *(remark.finding for remark in _remark_on_further(own, translated.nodes)),
    )
    if any(finding.severity == "error" for finding in findings):
        return Expanded(waiting, findings)
    made = {NODES: attrs.evolve(written, value=dict(translated.nodes), raw=None)}
    merged = lay_over(attrs.evolve(node, value={**made, **translated.options}), rest)
    return Expanded(merged, findings)


def _translate(
    options: Muto, written: YamlNode, own: Mapping[str, YamlNode], surroundings: Surroundings
) -> Translation | Finding:
    """Return the stack's nodes, or why it has none; with nodes of its own a job needs none."""
    assert surroundings.directory is not None, "asked before"
    given = {name: text_of(value) for name, value in options.args.items()}
    at = locate(written, ("stack",))
    try:
        ask = _choose_twin(options, surroundings)
        home, chosen = surroundings.home, options.references
        name = options.stack if isinstance(options.stack, str) else at
        stack, find = open_stack(name, surroundings.directory, home, ask, chosen)
        made = translate(stack, given, find)
        return made if own else require_nodes(stack, made)
    except NotAsked:
        message = (
            f"{options.twin_url} is not queried for the stack: only render, diff and run do that"
        )
        return note(at, message, "not-fetched").finding
    except Unreadable as fault:
        return fault.remark.finding
    except NotFound as fault:
        return make_finding(at, str(fault), "unknown-stack")
    except UserError as fault:
        kind = "untrusted" if isinstance(fault, Untrusted) else "bad-file"
        hint = f" ({fault.hint})" if fault.hint else ""
        return make_finding(at, f"{fault.message}{hint}", kind)


def _choose_twin(options: Muto, surroundings: Surroundings) -> Find | None:
    """Return what finds the stacks of the Ditto that the options name, None if they name none."""
    url, access = options.twin_url, options.access
    if url is None:
        return None
    fetched = surroundings.fetched
    twin = None if fetched is None else Twin(url, access, surroundings.environ, fetched)

    def ask(identifier: str) -> Stack:
        if twin is None:
            raise NotAsked
        if access.secret:
            what = f"the environment variable {access.secret} would be sent to {url}"
            require_trust(surroundings.home, what)
        return twin.find(identifier)

    return ask


def _entries_of(own: YamlNode | None) -> Mapping[str, YamlNode]:
    value: Any = own.value if own is not None else None
    return value if isinstance(value, dict) else {}


def _remark_on_further(own: Mapping[str, YamlNode], nodes: Mapping[str, YamlNode]) -> list[Remark]:
    """Remark on entries of `nodes` that are probably meant for a node of the stack."""
    remarks = []
    for key, entry in own.items():
        close = find_nearest(key, nodes)
        says = entry.value.keys() if isinstance(entry.value, dict) else ()
        if key not in nodes and close and not PROGRAMS.intersection(says):
            message = f'the stack has no node "{key}", did you mean "{close}"?'
            remarks.append(note(entry, message, "unknown-node", key=True))
    return remarks


EXTENSION = Extension.of(
    KEY,
    Muto | str | None,
    "a stack of Eclipse Muto, into whose nodes `nodes` are merged; a word is short for its `stack`",
    expand,
)
