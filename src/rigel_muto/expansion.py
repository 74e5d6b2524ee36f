"""The option `muto` of a job: its stack's nodes become the job's `nodes`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile.expansion import Expanded, Surroundings
from rigel_k8s.rigelfile.findings import Finding, find_nearest, make_finding
from rigel_k8s.rigelfile.source import YamlNode, locate
from rigel_k8s.rigelfile.structure import structure
from rigel_k8s.system.trust import Untrusted, require_trust
from rigel_muto.library import NotFound
from rigel_muto.opening import Find, open_stack
from rigel_muto.options import Muto, muto_of
from rigel_muto.remarks import Remark, Unreadable, leave_out_replaced, list_findings, note
from rigel_muto.stack import Stack
from rigel_muto.translation import Translation, require_nodes, translate
from rigel_muto.twin import Twin

KEY, NODES = "muto", "nodes"
#: Options with which an entry of `nodes` is a node of its own.
PROGRAMS = frozenset(("package", "launch", "args", "command", "image"))


class NotAsked(Exception):
    """A stack is at another machine, which must not be queried now."""


def expand(node: YamlNode, surroundings: Surroundings) -> Expanded:
    """Return a job's options with the stack's nodes in place of `muto`.

    A wrong form of `muto` itself is left to the reader of all options.
    """
    written = node.value.get(KEY)
    if written is None or written.value is None:
        return Expanded(node)
    found = None if written.has_hole() else structure(written, Muto | str)
    if found is None or found.value is None or surroundings.directory is None:
        return Expanded(_wait(node, written))
    try:
        options = muto_of(found.value)
    except ValueError:
        return Expanded(_wait(node, written))
    assert options is not None, "there is a value"
    own = node.value.get(NODES)
    translated = _translate(options, written, _entries_of(own), surroundings)
    if isinstance(translated, Finding):
        return Expanded(_wait(node, written), (translated,))
    remarks = leave_out_replaced(translated.remarks, node, _entries_of(own))
    findings = (
        *list_findings(remarks, strict=options.strict),
        *(remark.finding for remark in _remark_on_further(own, translated.nodes)),
    )
    if any(finding.severity == "error" for finding in findings):
        return Expanded(_wait(node, written), findings)
    return Expanded(_replace(node, written, translated), findings)


def _translate(
    options: Muto, written: YamlNode, own: Mapping[str, YamlNode], surroundings: Surroundings
) -> Translation | Finding:
    """Return the stack's nodes, or why it has none; with nodes of its own a job needs none."""
    assert surroundings.directory is not None, "asked before"
    given = {name: text_of(value) for name, value in options.args.items()}
    at = locate(written, ("stack",))
    try:
        ask = _choose_twin(options, surroundings)
        stack, find = open_stack(options.name, surroundings.directory, surroundings.home, ask)
        made = translate(stack, given, find)
        return made if own else require_nodes(stack, made)
    except NotAsked:
        message = (
            f"{options.base_url} is not queried for the stack: only render, diff and run do that"
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
    url, access = options.base_url, options.access
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


def _wait(node: YamlNode, written: YamlNode) -> YamlNode:
    """Return options whose `nodes` are not known."""
    unknown = attrs.evolve(written, value=None, raw=None, hole=True)
    return attrs.evolve(node, value={**node.value, NODES: unknown})


def _replace(node: YamlNode, written: YamlNode, made: Translation) -> YamlNode:
    """Return options with those of a stack, the Rigelfile's own laid over them, for `muto`."""
    rest = {key: value for key, value in node.value.items() if key != KEY}
    nodes = attrs.evolve(written, value=dict(made.nodes), raw=None)
    stacked = {NODES: nodes, **made.options}
    merged = {
        key: lay_over(value, rest[key]) if key in rest else value for key, value in stacked.items()
    }
    return attrs.evolve(node, value={**rest, **merged})


def lay_over(base: YamlNode, over: YamlNode) -> YamlNode:
    """Return a value with another one laid over it: mappings by key, where null removes a key."""
    if not isinstance(base.value, dict) or not isinstance(over.value, dict):
        return over
    merged = dict(base.value)
    for key, value in over.value.items():
        if key in merged and value.value is None and not value.hole:
            del merged[key]
        else:
            merged[key] = lay_over(merged[key], value) if key in merged else value
    return attrs.evolve(base, value=merged)


def _entries_of(own: YamlNode | None) -> Mapping[str, YamlNode]:
    value: Any = own.value if own is not None else None
    return value if isinstance(value, dict) else {}


def _remark_on_further(own: YamlNode | None, nodes: Mapping[str, YamlNode]) -> list[Remark]:
    """Remark on entries of `nodes` that are probably meant for a node of the stack."""
    remarks = []
    for key, entry in _entries_of(own).items():
        close = find_nearest(key, nodes)
        says = entry.value.keys() if isinstance(entry.value, dict) else ()
        if key not in nodes and close and not PROGRAMS.intersection(says):
            message = f'the stack has no node "{key}", did you mean "{close}"?'
            remarks.append(note(entry, message, "unknown-node", key=True))
    return remarks
