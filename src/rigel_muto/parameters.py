"""The parameters of a node, or of a whole stack, as options: values, files and commands."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile.limits import LONGEST_NUMBER
from rigel_k8s.rigelfile.source import YamlNode, kind_of, node_of
from rigel_muto.arguments import Completion
from rigel_muto.remarks import Unreadable, describe_unknown, error
from rigel_muto.stack import is_empty

KEYS = ("name", "value", "from", "command", "namespace", "sep")


class Parameters:
    """Parameters on their way into options.

    Args:
        whole: they are those of a stack: global, and each may have a namespace. Muto ignores the
            namespace of a single value of a node.
    """

    def __init__(self, completion: Completion, *, whole: bool = False) -> None:
        self._completion = completion
        self._whole = whole
        self._values: dict[str, YamlNode] = {}
        self._files: list[YamlNode] = []
        self._commands: dict[str, YamlNode] = {}

    def add(self, entry: YamlNode) -> None:
        """Add an entry of `param`. Raises Unreadable if it cannot be used."""
        for key, value in entry.value.items():
            if key not in KEYS and not is_empty(value):
                message = describe_unknown(key, "a parameter", KEYS)
                self._completion.lose(value, message, (), "not-carried")
        if _says(entry, "from"):
            self._add_file(entry)
        elif _says(entry, "command"):
            self._add_command(entry)
        else:
            self._add_value(entry)

    def options(self, at: YamlNode) -> dict[str, YamlNode]:
        """Return the options; they stand where the section does."""
        found: dict[str, YamlNode] = {}
        made = {
            "parameters": self._values,
            "parameter_files": self._files,
            "parameter_commands": self._commands,
        }
        for key, value in made.items():
            if value:
                place = attrs.evolve(at, value=value, raw=None)
                found[key] = attrs.evolve(place, key_span=at.key_span or at.span)
        return found

    def _add_value(self, entry: YamlNode) -> None:
        name = self._name(entry)
        value = entry.value.get("value")
        if value is None or value.value is None:
            raise Unreadable(error(entry, f'the parameter "{name}" has no value', "missing-key"))
        what = f'the parameter "{name}"'
        resolved = self._completion.complete(what, ("parameters", name), value)
        if resolved is not None:
            self._values[name] = _keyed(give_type(resolved), entry.value["name"])

    def _add_file(self, entry: YamlNode) -> None:
        path = self._completion.complete("the file", ("parameter_files",), entry.value["from"])
        if path is None:
            return
        file = {"image_file": _keyed(_text(path, "from"), entry.value["from"])}
        if namespace := self._namespace(entry):
            given = entry.value["namespace"]
            file["namespace"] = _keyed(node_of(namespace, given), given)
        self._files.append(attrs.evolve(entry, value=file, raw=None))

    def _add_command(self, entry: YamlNode) -> None:
        name = self._name(entry)
        what = f'the command of the parameter "{name}"'
        option = ("parameter_commands", name)
        line = self._completion.complete(what, option, entry.value["command"])
        if line is not None:
            self._commands[name] = _keyed(_text(line, "command"), entry.value["name"])

    def _name(self, entry: YamlNode) -> str:
        """Return the name that an entry must have, below its namespace."""
        if not _says(entry, "name"):
            raise Unreadable(error(entry, 'the key "name" is missing', "missing-key"))
        name = self._know(entry, "name")
        namespace = self._namespace(entry) if self._whole else ""
        return f"{namespace}/{name}" if namespace else name

    def _namespace(self, entry: YamlNode) -> str:
        return self._know(entry, "namespace").strip("/") if _says(entry, "namespace") else ""

    def _know(self, entry: YamlNode, key: str) -> str:
        """Return a text that must be known here. Raises Unreadable if it is not."""
        return text_of(_text(self._completion.know(key, entry.value[key]), key).value)


def merge(base: Mapping[str, YamlNode], more: Mapping[str, YamlNode]) -> dict[str, YamlNode]:
    """Return the options of two stacks; a parameter of the second one wins."""
    merged = dict(base)
    for key, node in more.items():
        before = merged.get(key)
        value = node.value
        if before is not None and isinstance(value, dict):
            value = {**before.value, **value}
        elif before is not None and isinstance(value, list):
            value = [*before.value, *value]
        merged[key] = attrs.evolve(node, value=value)
    return merged


def _says(entry: YamlNode, key: str) -> bool:
    return key in entry.value and not is_empty(entry.value[key])


def _keyed(node: YamlNode, key: YamlNode) -> YamlNode:
    """Return a value whose key has the place of the stack's key."""
    return attrs.evolve(node, key_span=key.span)


def _text(node: YamlNode, key: str) -> YamlNode:
    """Return a value that must be text. Raises Unreadable if it is not."""
    if not isinstance(node.value, str):
        message = f'"{key}" must be text, got {kind_of(node.value)}'
        raise Unreadable(error(node, message, "wrong-type"))
    return node


_WHOLE_NUMBER = re.compile(r"[-+]?\d+")
_NUMBER = re.compile(r"[-+]?(\d+\.\d*|\.\d+|\d+(?=[eE]))([eE][-+]?\d+)?")
_TRUTHS = {"true": True, "false": False}


def give_type(node: YamlNode) -> YamlNode:
    """Return a text that is written as a number or boolean as one: "2" is 2; others unchanged."""
    text: Any = node.value
    if not isinstance(text, str):
        return node
    if text.lower() in _TRUTHS:
        return node_of(_TRUTHS[text.lower()], node)
    if len(text) > LONGEST_NUMBER:
        return node
    if _WHOLE_NUMBER.fullmatch(text):
        return node_of(int(text), node)
    return node_of(float(text), node) if _NUMBER.fullmatch(text) else node
