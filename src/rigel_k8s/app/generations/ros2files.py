"""Parameter files of ROS 2 as rcl reads them: whose parameters they have, and which values.

rcl ends a node for a file that it cannot read, and leaves parameters out, without a word, that are
those of other nodes. A file of plain names and values is made one for any node.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import attrs
import yaml

from rigel_k8s.app.parameters import Fault
from rigel_k8s.objects.text import join_words
from rigel_k8s.yaml_text import Loader

#: The parameters of all nodes of a process.
ANY_NODE = "/**"
PARAMETERS = "ros__parameters"
#: A key of nodes: names, `*` for one name, `**` for any number.
KEY = re.compile(r"/?([A-Za-z_]\w*|\*\*?)(/([A-Za-z_]\w*|\*\*?))*", re.ASCII)
#: How rcl reads what is not in quotes.
BOOLEANS = frozenset(["y", "yes", "true", "n", "no", "false", "on", "off"])
INTEGER = re.compile(r"[-+]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9]\d*)", re.ASCII)
#: A line that begins or ends a document, with the rest of it; and one before that, as %YAML 1.2.
MARK = re.compile(r"(---|\.\.\.)(?:[ \t]+(.*))?|%.*")


@attrs.frozen
class Reading:
    """A file as far as rcl reads it.

    Attributes:
        keys: the nodes that have parameters in it, each with the place of its key; None: the file
            has plain names and values.
        plain: the first keys of a file with plain names and values, with the place of each that has
            a mapping.
    """

    faults: tuple[Fault, ...]
    keys: tuple[tuple[str, tuple[int, int]], ...] | None
    plain: tuple[tuple[str, tuple[int, int] | None], ...] = ()


def nest_parameters(text: str) -> str:
    """Return a parameter file as rcl reads it; plain names and values apply to any node.

    The text itself is kept: rcl reads 1e3 as a number, our YAML parser as text.
    """
    if has_key(yaml.compose(text, Loader), PARAMETERS):
        return text
    body = textwrap.indent("\n".join(drop_marks(text)), "    ")
    return f"{ANY_NODE}:\n  {PARAMETERS}:\n{body}\n"


def drop_marks(text: str) -> Iterator[str]:
    """Yield the lines of a YAML document without what begins or ends it."""
    for line in text.removeprefix("\ufeff").splitlines():
        found = MARK.fullmatch(line.rstrip())
        if found is None:
            yield line
        elif (rest := (found[2] or "").strip()) and not rest.startswith("#"):
            yield rest


def has_key(node: yaml.Node | None, key: str) -> bool:
    """Return whether a tree of mappings has a key anywhere."""
    if not isinstance(node, yaml.MappingNode):
        return False
    return any(name.value == key or has_key(value, key) for name, value in node.value)


def check_file(text: str, name: str | None, parts: Sequence[str] = ()) -> Iterator[Fault]:
    """Yield what is wrong with a file of a node.

    Args:
        name: the node's full ROS name; None: it is not known.
        parts: the full names of further nodes in its process.
    """
    reading = read(text)
    yield from reading.faults
    for key, mark in reading.plain:
        if mark and (key.startswith("/") or matches(key, name)):
            message = f'"{key}" is read as a parameter, since the file has no {PARAMETERS}: write'
            yield Fault(f"{message} {key}: {{{PARAMETERS}: ...}}", mark, ends=key.startswith("/"))
    if not reading.keys or name is None or reading.faults:
        return
    if any(matches(key, one) for key, _ in reading.keys for one in (name, *parts)):
        return
    one = "its key is" if len(reading.keys) == 1 else "its keys are"
    listed = join_words(key for key, _ in reading.keys)
    yield Fault(f"no parameters for {name} in this file; {one} {listed}", ends=False)


@lru_cache(maxsize=256)  # of many uses of a file
def read(text: str) -> Reading:
    """Return what rcl reads of a file that is YAML."""
    faults = [Fault(f"rcl does not read {what}", mark) for what, mark in find_aliases(text)]
    root = yaml.compose(text, Loader)
    if not isinstance(root, yaml.MappingNode):
        return Reading(tuple(faults), None)
    if not has_key(root, PARAMETERS):
        for name, value in root.value:
            faults += check_parameter_value(name.value, value)
        plain = [
            (str(name.value), place(name) if isinstance(value, yaml.MappingNode) else None)
            for name, value in root.value
        ]
        return Reading(tuple(faults), None, tuple(plain))
    keys: list[tuple[str, tuple[int, int]]] = []
    faults += read_nodes(root, (), keys)
    return Reading(tuple(faults), tuple(keys))


def read_nodes(
    node: yaml.MappingNode, above: Sequence[str], keys: list[tuple[str, tuple[int, int]]]
) -> Iterator[Fault]:
    """Yield what is wrong above and below each `ros__parameters`; `keys` gets their nodes."""
    for name, value in node.value:
        path = "/".join(above)
        if name.value == PARAMETERS:
            if not above:
                yield Fault(f"no node's name is before {PARAMETERS}: write {ANY_NODE}", place(name))
            elif not isinstance(value, yaml.MappingNode):
                yield Fault(f"{PARAMETERS} of {path} has no names and values", place(name))
            else:
                keys.append((path, place(name)))
                for inner, one in value.value:
                    yield from check_parameter_value(str(inner.value), one)
        elif not isinstance(value, yaml.MappingNode):
            where = f"below {PARAMETERS}" if above else f"as {ANY_NODE}: {{{PARAMETERS}: ...}}"
            yield Fault(f'"{name.value}" is outside of {PARAMETERS}: write it {where}', place(name))
        elif not KEY.fullmatch(str(name.value)):
            yield Fault(f'"{name.value}" is not the name of a node', place(name))
        else:
            yield from read_nodes(value, (*above, str(name.value)), keys)


def check_parameter_value(name: str, node: yaml.Node) -> Iterator[Fault]:
    """Yield why rcl has no type for a value."""
    if isinstance(node, yaml.MappingNode):
        if not node.value:
            yield Fault(f'"{name}" has no names and values: leave it out', place(node))
        for inner, value in node.value:
            yield from check_parameter_value(f"{name}.{inner.value}", value)
        return
    if isinstance(node, yaml.ScalarNode):
        if is_empty(node):
            yield Fault(f'the parameter "{name}" has no value', place(node))
        return
    if not node.value:
        yield Fault(f'the list "{name}" is empty, and has no type: leave it out', place(node))
    elif not all(isinstance(one, yaml.ScalarNode) for one in node.value):
        yield Fault(f'the list "{name}" must have plain values, all of one type', place(node))
    elif any(map(is_empty, node.value)):
        yield Fault(f'the list "{name}" has an item without a value', place(node))
    elif len(kinds := {kind_of(one) for one in node.value}) > 1:
        hint = ": write 1.0 for 1" if kinds == {"integer", "double"} else ""
        yield Fault(f'the list "{name}" must have values of one type{hint}', place(node))


def is_empty(node: yaml.ScalarNode) -> bool:
    """Return whether a value is none; rcl would read `null` as the text."""
    return str(node.tag) == "tag:yaml.org,2002:null"


def kind_of(node: yaml.ScalarNode) -> str:
    """Return the type that rcl reads."""
    text = str(node.value)
    if node.style in ("'", '"', "|", ">"):
        return "string"
    if text.lower() in BOOLEANS and text in (text.lower(), text.upper(), text.capitalize()):
        return "bool"
    if INTEGER.fullmatch(text):
        return "integer"
    try:
        float(text.lower().removeprefix(".") if text.lower() in (".inf", ".nan") else text)
    except ValueError:
        return "string"
    return "string" if "_" in text else "double"


def find_aliases(text: str) -> Iterator[tuple[str, tuple[int, int]]]:
    """Yield references to other values, which end a node."""
    if "*" not in text or "&" not in text:
        return
    for event in yaml.parse(text, Loader):
        if isinstance(event, yaml.AliasEvent):
            yield f"*{event.anchor}: write the value again", place(event)


def place(node: Any) -> tuple[int, int]:
    """Return the line and column of a node or an event of PyYAML."""
    return node.start_mark.line + 1, node.start_mark.column + 1


def matches(key: str, name: str | None) -> bool:
    """Return whether a key of a file is that of a node, as rcl compares them."""
    if name is None:
        return False
    steps = [
        {"*": "/[^/]+", "**": "(?:/[^/]+)*"}.get(step, "/" + re.escape(step))
        for step in key.strip("/").split("/")
    ]
    return re.fullmatch("".join(steps), name) is not None
