"""The tags of a launch file in XML, or the actions of one in YAML, with their places."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from xml.parsers import expat

import attrs

from rigel_import.draft import Place
from rigel_import.text import read_text
from rigel_k8s.errors import UserError
from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile.findings import problems_error
from rigel_k8s.rigelfile.limits import DEEPEST
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import Source, YamlNode, strip_places

#: Keys of YAML whose lists contain actions, not values of one kind.
BLOCKS = ("launch", "group", "timer", "children")


@attrs.define
class Entity:
    """A tag or an action.

    Attributes:
        values: its attributes; in YAML they have types, and may be lists of scalars.
        text: what is between its tags, or the value of a YAML action that is only a text.
    """

    tag: str
    place: Place
    values: dict[str, Any] = attrs.field(factory=dict)
    children: list[Entity] = attrs.field(factory=list)
    text: str = ""


def as_text(value: Any) -> str:
    """Return an attribute in YAML as the text that it would be in XML."""
    return " ".join(map(text_of, value)) if isinstance(value, list) else text_of(value)


def read_file(file: Path) -> Entity:
    """Return the root of a launch file in XML or YAML. Raises UserError if it is not one."""
    read = read_yaml if file.suffix in (".yaml", ".yml") else read_xml
    root = read(read_text(file), os.path.relpath(file))
    if root.tag != "launch":
        message = f"{root.place}: the first tag is `{root.tag}`, not `launch`"
        raise UserError(message, hint="choose a launch file")
    return root


def read_xml(text: str, name: str) -> Entity:
    """Return the root of an XML file. Raises UserError if it is not one."""
    parser = expat.ParserCreate("utf-8")  # whatever its first line says: it is decoded already
    parser.buffer_text = True
    opened = [Entity("", Place(name, 1))]

    def start(tag: str, values: dict[str, str]) -> None:
        entity = Entity(tag, Place(name, parser.CurrentLineNumber), values)
        if len(opened) > DEEPEST:
            message = f"{entity.place}: more than {DEEPEST} tags are nested"
            raise UserError(message, hint="use `include`")
        opened[-1].children.append(entity)
        opened.append(entity)

    def add_text(text: str) -> None:
        opened[-1].text += text

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: opened.pop()
    parser.CharacterDataHandler = add_text
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        message = f"{Place(name, error.lineno)}: invalid XML: {expat.ErrorString(error.code)}"
        raise UserError(message, hint="correct the line, or a tag before it") from None
    return opened[0].children[0]


def read_yaml(text: str, name: str) -> Entity:
    """Return the root of a YAML launch file. Raises UserError if it is not one."""
    source = Source(name, text)
    content, findings = parse(source)
    if findings:
        raise problems_error(source, findings)
    root = content.value if content else None
    launch = root.get("launch") if isinstance(root, dict) else None
    if launch is None or not isinstance(launch.value, list):
        message = f'{Place(name, 1)}: a launch file in YAML is a mapping with the list "launch"'
        raise UserError(message, hint="begin it with a line `launch:`")
    return _read_entity("launch", launch, name)


def _read_entity(tag: str, node: YamlNode, name: str) -> Entity:
    """Return the value of a key as an entity."""
    entity = Entity(tag, Place(name, (node.key_span or node.span).line), text=node.raw or "")
    if isinstance(node.value, list):
        entity.children = [_read_action(item, name) for item in node.value]
    for key, value in node.value.items() if isinstance(node.value, dict) else ():
        if isinstance(value.value, dict):
            entity.children.append(_read_entity(key, value, name))
        elif isinstance(value.value, list) and key in BLOCKS:
            entity.children += [_read_action(item, name) for item in value.value]
        elif any(isinstance(item.value, dict) for item in value.children()):
            entity.children += [_read_entity(key, item, name) for item in value.value]
        else:
            entity.values[key] = strip_places(value)
    return entity


def _read_action(item: YamlNode, name: str) -> Entity:
    """Return an entry of a list of actions: a mapping with one key."""
    if not isinstance(item.value, dict) or len(item.value) != 1:
        message = f"{Place(name, item.span.line)}: an action must be a mapping with one key"
        raise UserError(message, hint="write it as `- node: { pkg: ..., exec: ... }`")
    ((tag, value),) = item.value.items()
    return _read_entity(tag, value, name)
