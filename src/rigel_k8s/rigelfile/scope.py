"""Fills templates: `vars` when the file is read, `data` when a job runs; reports what is wrong.

A text that waits for data stays unchanged and is marked as a hole; so is a text whose
template is wrong: only the template is reported, once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from typing import Any

import attrs

from rigel_k8s.option_text import has_template
from rigel_k8s.rigelfile.findings import Finding, find_nearest, make_finding
from rigel_k8s.rigelfile.limits import LONGEST_CHAIN, MOST_SUGGESTIONS
from rigel_k8s.rigelfile.source import Source, Span, YamlNode, kind_of, node_of
from rigel_k8s.rigelfile.spending import KIND, Spending
from rigel_k8s.rigelfile.template import (
    HEADERS,
    Expression,
    Name,
    Part,
    Unclosed,
    add_origin,
    convert_numbers,
    find_span,
    join,
    place_value,
    read_text,
    split,
)


class _Wrong(Exception):
    """A template that cannot be filled, and why."""

    def __init__(self, message: str, kind: str = "template") -> None:
        super().__init__(message)
        self.message = message
        self.kind = kind


class _Waits(Exception):
    """A template that needs data which is not available yet."""


class Scope:
    """What templates may refer to.

    Args:
        source: the file, to point at a template inside a text.
        variables: the Rigelfile's `vars`, as written.
        environ: the environment, for names that `vars` does not have.
        data: what jobs have stored; None: nothing is known yet.
        final: no more data will come, so an unknown `data.x` is wrong.
        patient: an undefined variable is a hole too, until `final`: a caller that only reads
            the application's name does not need the values for its deployment.
        spent: what the file has expanded to before; None: nothing.
        fetched: what other machines answered so far, by URL; None: they must not be asked.
    """

    def __init__(
        self,
        source: Source,
        variables: Mapping[str, YamlNode],
        environ: Mapping[str, str],
        data: Mapping[str, Any] | None = None,
        *,
        final: bool = False,
        patient: bool = False,
        spent: Spending | None = None,
        fetched: MutableMapping[str, str] | None = None,
    ) -> None:
        self.source = source
        self.variables = variables
        self.environ = environ
        self.fetched = fetched
        self.findings: list[Finding] = []
        self._data = data or {}
        self._final = final
        self._patient = patient
        self._spent = spent or Spending(source)
        self._rendered: dict[str, YamlNode] = {}
        self._open: list[str] = []

    def with_data(self, data: Mapping[str, Any] | None, *, final: bool) -> Scope:
        """Return a scope of the same vars with these data."""
        return Scope(
            self.source,
            self.variables,
            self.environ,
            data,
            final=final,
            patient=self._patient,
            spent=None if final else self._spent,  # in a run, the size grows with the data
            fetched=self.fetched,
        )

    def add_look(self, options: YamlNode) -> None:
        """Count options that are about to be checked. Raises TooLarge."""
        self._spent.add_look(options)

    # Nodes

    def render(self, node: YamlNode) -> YamlNode:
        """Return the node with templates filled where possible; findings have the rest."""
        return self._walk(node, self._render_text)

    def fill(self, node: YamlNode) -> YamlNode:
        """Return a rendered node with its holes filled, as far as the data is known."""

        def fill_text(node: YamlNode) -> YamlNode:
            return self._render_text(attrs.evolve(node, hole=False)) if node.hole else node

        return self._walk(node, fill_text)

    def render_variables(self) -> dict[str, YamlNode]:
        """Return all vars, rendered."""
        return {name: self._render_variable(name) for name in self.variables}

    def _render_text(self, node: YamlNode) -> YamlNode:
        templated = isinstance(node.value, str) and has_template(node.value)
        return self._text(node) if templated else node

    def _walk(self, node: YamlNode, text: Callable[[YamlNode], YamlNode]) -> YamlNode:
        if node.source is not None:
            return node  # of another file, perhaps of another person: braces in it are text
        if isinstance(node.value, dict):
            return self._mapping(node, text)
        if isinstance(node.value, list):
            items = [self._walk(item, text) for item in node.value]
            same = all(new is old for new, old in zip(items, node.value, strict=True))
            return node if same else attrs.evolve(node, value=items)
        return text(node)

    def _mapping(self, node: YamlNode, text: Callable[[YamlNode], YamlNode]) -> YamlNode:
        result: dict[str, YamlNode] = {}
        same = True
        for key, value in node.value.items():
            new_key = self._key(key, value) if has_template(key) else key
            new = self._walk(value, text)
            same = same and new is value and new_key == key
            if new_key in result:
                message = f'another template already gives the key "{new_key}" here'
                self.findings.append(make_finding(value, message, "duplicate-key", key=True))
            else:
                result[new_key] = new
        return node if same else attrs.evolve(node, value=result)

    def _key(self, key: str, value: YamlNode) -> str:
        span = value.key_span or value.span
        text = self._text(YamlNode(key, span, raw=key))
        if isinstance(text.value, dict | list):
            message = f"a key must be text, but {key} is {kind_of(text.value)}"
            self.findings.append(make_finding(text, message, "template"))
            return key
        return read_text(text)

    def _text(self, node: YamlNode) -> YamlNode:
        pieces = list(split(node.value))
        try:
            templates = [part for part in pieces if not isinstance(part, str)]
            if len(templates) == 1 and "".join(p for p in pieces if isinstance(p, str)).isspace():
                pieces = list(templates)
            values = self._values(node, pieces)
        except _Waits:
            return attrs.evolve(node, hole=True)
        if len(pieces) == 1:
            return values[0]
        self._spent.add_text(node, sum(len(read_text(value)) for value in values))
        return join(node, values)

    def _values(self, node: YamlNode, pieces: list[Part]) -> list[YamlNode]:
        """Return the value of each piece; _Waits, after all wrong ones are reported."""
        values: list[YamlNode] = []
        waits = False
        for number, piece in enumerate(pieces):
            if isinstance(piece, str):
                values.append(YamlNode(piece, node.span, raw=piece))
                continue
            try:
                found = self._value(node, piece)
                self._spent.add_values(node, found)
                value = place_value(node, found)
                waits = waits or value.has_hole()
                values.append(value)
                if len(pieces) > 1 and isinstance(value.value, dict | list):
                    raise _Wrong(f"{piece.text} is {kind_of(value.value)}, not part of a text")
            except _Waits:
                waits = True
            except _Wrong as wrong:
                waits = True
                span = find_span(self.source, node, piece.text, pieces[:number].count(piece))
                finding = make_finding(node, wrong.message, wrong.kind)
                self.findings.append(attrs.evolve(finding, span=span))
        if waits and (len(pieces) > 1 or not values or values[0].hole):
            raise _Waits
        return values

    # Names

    def _value(self, node: YamlNode, piece: Name | Expression | Unclosed) -> YamlNode:
        if isinstance(piece, Unclosed):
            raise _Wrong("{{ without }} (to write the braces themselves: {{ '{{' }})")
        if isinstance(piece, Expression):
            return self._expression(node, piece)
        if piece.header not in HEADERS:
            raise _Wrong(_bad_header(piece))
        found = self._look_up(node, piece.header, piece.name)
        if found is not None:
            return found
        raise self._judge_missing(piece.header, piece.name)

    def _look_up(self, node: YamlNode, header: str, name: str) -> YamlNode | None:
        if header == "data":
            try:
                value = _find_data(self._data, name)
            except LookupError:
                return None
            return attrs.evolve(
                _make_node(value, node, f"data.{name}"), untyped=isinstance(value, str)
            )
        return self._variable(name)

    def _variable(self, name: str) -> YamlNode | None:
        if name in self.variables:
            return self._render_variable(name)
        first, _, rest = name.partition(".")
        if rest and first in self.variables:
            node: YamlNode | None = self._render_variable(first)
            for step in rest.split("."):
                node = node.value.get(step) if node and isinstance(node.value, dict) else None
            return node
        if name in self.environ:
            text = self.environ[name]
            return YamlNode(text, _NOWHERE, raw=text, untyped=True, environment=name)
        return None

    def _render_variable(self, name: str) -> YamlNode:
        if name in self._rendered:
            return self._rendered[name]
        if name in self._open:
            circle = " -> ".join(f"vars.{n}" for n in (*self._open[self._open.index(name) :], name))
            raise _Wrong(f"variables refer to each other in a circle: {circle}", "variable-cycle")
        if len(self._open) >= LONGEST_CHAIN:
            raise _Wrong(f"more than {LONGEST_CHAIN} variables need each other in a chain", KIND)
        self._open.append(name)
        try:
            self._rendered[name] = self.render(self.variables[name])
        finally:
            self._open.pop()
        return self._rendered[name]

    def _judge_missing(self, header: str, name: str) -> _Wrong | _Waits:
        """Return whether an unknown name may still become known, or what is wrong with it."""
        if (header == "data" or self._patient) and name and not self._final:
            return _Waits()
        return self._explain_unknown(header, name)

    def _explain_unknown(self, header: str, name: str) -> _Wrong:
        if header == "data":
            near = find_nearest(name, self._data)
            stored = ", ".join(f"data.{key}" for key in self._data) or "nothing yet"
            hint = f"did you mean data.{near}?" if near else f"earlier jobs stored {stored}"
            return _Wrong(f"no earlier job has stored data.{name}, {hint}", "unknown-data")
        if not name:
            return _Wrong("vars. needs a name after the dot", "unknown-variable")
        first, dot, rest = name.partition(".")
        if dot and first in self.variables:
            return _Wrong(f'vars.{first} has no "{rest}"', "unknown-variable")
        few = len(self.findings) < MOST_SUGGESTIONS
        near = find_nearest(name, self.variables) if few else None
        hint = f"did you mean vars.{near}?" if near else f"declare it there or export {name}"
        message = f"vars.{name} is neither in vars nor in the environment, {hint}"
        return _Wrong(message, "unknown-variable")

    # Expressions

    def _expression(self, node: YamlNode, piece: Expression) -> YamlNode:
        if not piece.source:
            raise _Wrong("an empty template: write {{ vars.NAME }}")
        from rigel_k8s.rigelfile import expression

        values: dict[expression.Reference, Any] = {}
        found: list[YamlNode] = []
        missing: _Wrong | _Waits | None = None
        for reference in expression.references(piece.source, self._is_known):
            value = self._look_up(node, reference.header, reference.name)
            if value is not None:
                found.append(value)
                values[reference] = convert_numbers(value)
            elif reference.header == "data" and not self._final:
                raise _Waits
            else:
                missing = missing or self._judge_missing(reference.header, reference.name)
                values[reference] = expression.make_undefined(reference)
        if any(value.has_hole() for value in found):
            raise _Waits
        try:
            limits = self._spent.limit_expression(node)
            result = expression.evaluate(piece.source, values, limits)
        except expression.ExpressionError as error:
            raise (missing if missing and error.undefined else _Wrong(str(error))) from error
        self._spent.add_text(node, _count_text(result))
        return add_origin(_make_node(result, node, piece.source), found)

    def _is_known(self, header: str, name: str) -> bool:
        known: Mapping[str, Any] = self._data if header == "data" else self.variables
        return name in known or (header == "vars" and name in self.environ)


_NOWHERE = Span(0, 0, 0, 0)


def _find_data(data: Mapping[str, Any], name: str) -> Any:
    """Return `a.b`, or the value of `b` in the mapping `a`."""
    if name in data:
        return data[name]
    found: Any = data
    for step in name.split("."):
        if not isinstance(found, Mapping):
            raise LookupError(name)
        found = found[step]
    return found


def _count_text(value: Any) -> int:
    """Return the characters of all texts in plain data."""
    if isinstance(value, dict):
        return sum(map(_count_text, (*value, *value.values())))
    if isinstance(value, list):
        return sum(map(_count_text, value))
    return len(value) if isinstance(value, str) else 0


def _make_node(value: Any, node: YamlNode, what: str) -> YamlNode:
    try:
        return node_of(value, YamlNode(None, node.span, key_span=node.key_span))
    except TypeError as error:
        raise _Wrong(f"{what}: {error}") from error


def _bad_header(name: Name) -> str:
    written_name = f"{name.header}.{name.name}" if name.header else name.name
    if name.header in ("", "var", "env", "variables", "environment") and name.name:
        return f'"{written_name}" is not a template, did you mean vars.{name.name}?'
    return f'"{written_name}" is not a template: begin with vars. (also the environment) or data.'
