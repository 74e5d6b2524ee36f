"""`$(arg x)` in a stack's texts, and the expressions that only a container can resolve."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import attrs

from rigel_k8s.option_text import text_of
from rigel_k8s.problems import Path
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.rigelfile.limits import LONGEST_CHAIN, LONGEST_TEXT, MOST_TEXT
from rigel_k8s.rigelfile.source import YamlNode
from rigel_k8s.substitution_args import EXPRESSION, FORMS, is_substituted
from rigel_muto.remarks import Remark, Unreadable, error
from rigel_muto.stack import text_at

#: Remarks on what is lost: the value, the message, the option that would replace it, the kind.
Lose = Callable[[YamlNode, str, Path, str], None]


@attrs.define
class Allowance:
    """How many characters the arguments of all stacks of a job may still make."""

    left: int = MOST_TEXT


class Arguments:
    """The arguments of one stack.

    Args:
        declared: the entries of its section `arg`.
        given: values that override the declared ones; names that it does not have are ignored.
        allowance: shared by all stacks that are deployed together.
    """

    def __init__(
        self, declared: Iterable[YamlNode], given: Mapping[str, str], allowance: Allowance
    ) -> None:
        self.remarks: list[Remark] = []
        self._given = given
        self._allowance = allowance
        self._declared: dict[str, YamlNode] = {}
        self._values: dict[str, str] = {}
        self._open: list[str] = []
        for entry in declared:
            self._declare(entry)

    def _declare(self, entry: YamlNode) -> None:
        name = text_at(entry.value, "name")
        if name:
            self._declared[name] = entry
        else:
            self.remarks.append(error(entry, "an argument needs a name", "missing-key"))

    @property
    def names(self) -> frozenset[str]:
        """The names that the stack declares."""
        return frozenset(self._declared)

    def resolve(self, node: YamlNode) -> tuple[YamlNode, tuple[str, ...]]:
        """Return a value with the arguments in its texts filled in, and what is left to resolve.

        What is left, as `$(find robot)`, is known only inside of a container of the image.

        Raises:
            Unreadable: an argument that is unknown, has no value, or needs itself.
        """
        resolved = _map_texts(node, self._fill)
        return resolved, tuple(dict.fromkeys(_find_calls(resolved)))

    def _fill(self, text: str, at: YamlNode) -> str:
        parts, end = [], 0
        for match in EXPRESSION.finditer(text):
            words = match[1].split()
            if words[:1] == ["arg"] and len(words) == 2:
                parts += [text[end : match.start()], self._value(words[1], at)]
                end = match.end()
        if not parts:
            return text
        length = sum(map(len, parts)) + len(text) - end
        self._allowance.left -= length
        if length > LONGEST_TEXT or self._allowance.left < 0:
            message = (
                f"arguments make a text of more than {LONGEST_TEXT} characters, or all of them"
                f" together more than {MOST_TEXT}"
            )
            raise Unreadable(error(at, message, "too-large"))
        return "".join([*parts, text[end:]])

    def _value(self, name: str, at: YamlNode) -> str:
        """Return an argument's value, its own arguments filled in."""
        if name in self._open:
            chain = " -> ".join([*self._open[self._open.index(name) :], name])
            raise Unreadable(error(at, f"this argument needs itself: {chain}", "argument-cycle"))
        if len(self._open) == LONGEST_CHAIN:
            message = f"more than {LONGEST_CHAIN} arguments need each other"
            raise Unreadable(error(at, message, "too-large"))
        if name not in self._values:
            self._open.append(name)
            try:
                self._values[name] = self._find(name, at)
            finally:
                self._open.pop()
        return self._values[name]

    def _find(self, name: str, at: YamlNode) -> str:
        entry = self._declared.get(name)
        if entry is None:
            message = f'unknown argument "{name}"{suggest(name, sorted(self._declared))}'
            raise Unreadable(error(at, message, "unknown-argument"))
        if name in self._given:
            return self._given[name]
        value = entry.value.get("value", entry.value.get("default"))
        if value is None or isinstance(value.value, dict | list) or value.value is None:
            message = f'the argument "{name}" has no value: give it one in `args`, or as --arg'
            raise Unreadable(error(entry, message, "missing-argument"))
        return self._fill(text_of(value.value), value)


class Completion:
    """Values of one node, or of a whole stack, as far as they are known here.

    Attributes:
        lose: remarks on a value that cannot be carried over.
        substitutes: whether a container replaces something in the values so far.
    """

    def __init__(self, arguments: Arguments, lose: Lose) -> None:
        self.lose = lose
        self.substitutes = False
        self._arguments = arguments

    def complete(self, what: str, option: Path, value: YamlNode) -> YamlNode | None:
        """Return a value; None with a remark where not even a container could resolve it."""
        resolved, calls = self._arguments.resolve(value)
        if all(map(is_substituted, calls)):
            self.substitutes = self.substitutes or bool(calls)
            return resolved
        message = f"{what} cannot be carried over: {_explain(calls)}"
        self.lose(resolved, message, option, "needs-container")
        return None

    def know(self, key: str, value: YamlNode) -> YamlNode:
        """Return the value of a key. Raises Unreadable where only a container can resolve it."""
        resolved, calls = self._arguments.resolve(value)
        if calls:
            message = f'"{key}" must be known before the node runs: {_explain(calls)}'
            raise Unreadable(error(resolved, message, "needs-container"))
        return resolved


def _explain(calls: tuple[str, ...]) -> str:
    """Return why expressions are not known here."""
    unknown = [call for call in calls if not is_substituted(call)]
    if unknown:
        return f"{', '.join(unknown)} is none of {FORMS}"
    return f"only the image has {', '.join(calls)}"


def _map_texts(node: YamlNode, change: Callable[[str, YamlNode], str]) -> YamlNode:
    """Return a value whose texts are changed; one without a change is the same."""
    value: Any = node.value
    if isinstance(value, str):
        text = change(value, node)
        return node if text == value else attrs.evolve(node, value=text, raw=text)
    if isinstance(value, list):
        value = [_map_texts(child, change) for child in value]
    elif isinstance(value, dict):
        value = {key: _map_texts(child, change) for key, child in value.items()}
    return attrs.evolve(node, value=value)


def _find_calls(node: YamlNode) -> Iterable[str]:
    if isinstance(node.value, str):
        yield from (match[0] for match in EXPRESSION.finditer(node.value))
    for child in node.children():
        yield from _find_calls(child)
