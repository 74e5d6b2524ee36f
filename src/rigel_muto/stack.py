"""The model of a stack: its sections, each value with its place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import attrs

from rigel_k8s.rigelfile.source import YamlNode, kind_of
from rigel_muto.remarks import Remark, Unreadable, describe_unknown, error, loss

#: Keys of a stack that have a meaning here, and those that only Muto needs.
SECTIONS = ("arg", "param", "node", "composable", "stack")
DESCRIPTIONS = ("name", "context", "stackId", "description", "title", "version", "current", "state")


@attrs.frozen
class Archive:
    """Sources that a stack consists of, in place of nodes.

    Attributes:
        place: the mapping that contains them.
        values: its keys: `data` or `url`, `launch_file`, `checksum` and so on.
    """

    place: YamlNode
    values: Mapping[str, YamlNode]


@attrs.frozen
class Stack:
    """One stack.

    Attributes:
        ids: the names by which others refer to it: stackId, thingId.
        name: what people call it; "" where it has no name.
        place: the mapping that contains it.
        arguments, parameters, nodes, containers, references: the entries of its sections.
        parts: stacks that it consists of: the components of a Symphony solution.
        archive: the sources that it consists of; it has no sections then.
        remarks: what is wrong with its form.
        ros2: its form exists for ROS 2 only.
    """

    ids: tuple[str, ...]
    name: str
    place: YamlNode
    arguments: tuple[YamlNode, ...] = ()
    parameters: tuple[YamlNode, ...] = ()
    nodes: tuple[YamlNode, ...] = ()
    containers: tuple[YamlNode, ...] = ()
    references: tuple[YamlNode, ...] = ()
    parts: tuple[Stack, ...] = ()
    archive: Archive | None = None
    remarks: tuple[Remark, ...] = ()
    ros2: bool = False

    @property
    def needs_ros1(self) -> bool:
        """Whether it has what only ROS 1 has: global parameters, nodelets."""
        nodelets = (text_at(node.value, "pkg") == "nodelet" for node in self.nodes)
        return bool(self.parameters) or any(nodelets)

    @property
    def needs_build(self) -> bool:
        """Whether it, or a part of it, is an archive with sources."""
        return self.archive is not None or any(part.needs_build for part in self.parts)

    @property
    def label(self) -> str:
        """What to call it in messages."""
        return next(iter((*self.ids, self.name)), "") or "the stack"


def read_sections(place: YamlNode, *, ids: Iterable[str] = (), ros2: bool = False) -> Stack:
    remarks: list[Remark] = []
    found = {key: _list_entries(place.value, key, remarks) for key in SECTIONS}
    known = (*SECTIONS, *DESCRIPTIONS)
    for key, value in place.value.items():
        if key not in known and not is_empty(value):
            remarks.append(loss(value, describe_unknown(key, "a stack", known)))
    names = (name_at(place.value, "stackId"), *ids)
    lifecycles = (node.value.get("lifecycle") for node in found["node"])
    transitions = (one is not None and not is_empty(one) for one in lifecycles)
    return Stack(
        ids=tuple(dict.fromkeys(filter(None, names))),
        name=name_at(place.value, "name"),
        place=place,
        arguments=found["arg"],
        parameters=found["param"],
        nodes=found["node"],
        containers=found["composable"],
        references=found["stack"],
        remarks=tuple(remarks),
        ros2=ros2 or bool(found["composable"]) or any(transitions),  # only ROS 2 has them
    )


def _list_entries(
    content: Mapping[str, YamlNode], key: str, remarks: list[Remark]
) -> tuple[YamlNode, ...]:
    """Return the mappings in a list; remark on other values."""
    section = content.get(key)
    if section is None or is_empty(section):
        return ()
    if not isinstance(section.value, list):
        message = f'"{key}" must be a list, got {kind_of(section.value)}'
        remarks.append(error(section, message, "wrong-type"))
        return ()
    for entry in section.value:
        if not isinstance(entry.value, dict):
            message = f'an entry of "{key}" must be a mapping, got {kind_of(entry.value)}'
            remarks.append(error(entry, message, "wrong-type"))
    return tuple(entry for entry in section.value if isinstance(entry.value, dict))


def is_empty(node: YamlNode) -> bool:
    """Return whether a value is empty: Muto writes every key of its model."""
    return node.value is None or node.value in ("", [], {})


def text_at(content: Mapping[str, YamlNode], key: str) -> str:
    """Return the text of a key, "" without the key."""
    node = content.get(key)
    return node.value if node is not None and isinstance(node.value, str) else ""


def name_at(content: Mapping[str, YamlNode], key: str) -> str:
    """Return a name or an id, "" without the key. Raises Unreadable for another type."""
    node = content.get(key)
    if node is None or is_empty(node):
        return ""
    if not isinstance(node.value, str):
        message = f'"{key}" must be text, got {kind_of(node.value)}'
        raise Unreadable(error(node, message, "wrong-type"))
    return node.value
