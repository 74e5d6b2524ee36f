"""The forms of stacks, recognized by their keys.

bare stack        node, composable, stack, arg or param
Ditto thing       features.stack.properties is a bare stack; `items` is a list of things
stack/json        metadata.content_type, and launch with the sections of a bare stack
Symphony          spec.components with properties {type: stack, data: any of these as base64}
archives          stack/archive, and the older `artifact`: sources to build
"""

from __future__ import annotations

import attrs

from rigel_k8s.rigelfile.source import YamlNode, kind_of
from rigel_muto.reading import decode, read
from rigel_muto.remarks import Remark, Unreadable, error, loss
from rigel_muto.stack import (
    SECTIONS,
    Archive,
    Stack,
    is_empty,
    name_at,
    read_sections,
    text_at,
)

#: Keys that run a device's own files, and what to do instead: a pod has only those of its image.
ON_DEVICE = {
    "on_start": "deploy a node with `args: [bash, FILE]` and an image that has the script",
    "on_kill": "let the node's program do that work when it gets SIGINT",
    "launch_description_source": "deploy a node with `launch: {file: FILE}` and an image that has"
    " the file",
}
#: Components of a solution; the text of each may be as large as a Rigelfile.
MOST_COMPONENTS = 50
UNKNOWN = (
    "this is not a stack: expected `node`, `composable` or `stack`, a Ditto thing with the feature"
    " `stack`, `metadata.content_type: stack/json`, or a Symphony solution"
)


def list_stacks(root: YamlNode) -> tuple[Stack, ...]:
    """Return the stacks of a document, at least one.

    Raises:
        Unreadable: it is not a stack, or runs files of a device.
    """
    if isinstance(root.value, dict) and "items" in root.value:
        root = root.value["items"]
    if not isinstance(root.value, list):
        return (read_stack(root),)
    if not root.value:
        raise Unreadable(error(root, "this list contains no stack", "not-a-stack"))
    return tuple(read_stack(item) for item in root.value)


def read_stack(root: YamlNode) -> Stack:
    """Return the stack that a value is. Raises Unreadable as list_stacks."""
    if not isinstance(root.value, dict):
        message = f"a stack must be a mapping, got {kind_of(root.value)}"
        raise Unreadable(error(root, message, "not-a-stack"))
    content = root.value
    if "features" in content:
        return _read_thing(root)
    if "metadata" in content and "launch" in content:
        return _read_described(root)
    if "spec" in content:
        return _read_solution(root)
    if any(key in content and not is_empty(content[key]) for key in ("artifact", *ON_DEVICE)):
        return _read_legacy(root)
    if any(key in content for key in SECTIONS):
        return read_sections(root)
    raise Unreadable(error(root, UNKNOWN, "not-a-stack"))


def _read_thing(root: YamlNode) -> Stack:
    properties = _descend(root, "features", "stack", "properties")
    stack = read_stack(properties)
    ids = dict.fromkeys(filter(None, (*stack.ids, name_at(root.value, "thingId"))))
    return attrs.evolve(stack, ids=tuple(ids))


def _read_described(root: YamlNode) -> Stack:
    """Return a stack with `metadata` and `launch`, the form of Muto's ROS 2 generation."""
    metadata, launch = _descend(root, "metadata"), _descend(root, "launch")
    form = text_at(metadata.value, "content_type")
    name = name_at(metadata.value, "name")
    if form == "stack/archive":
        properties = launch.value.get("properties")
        more = properties.value if properties and isinstance(properties.value, dict) else {}
        values = {key: value for key, value in launch.value.items() if key != "properties"}
        return _make_archive(name, root, Archive(launch, {**values, **more}))
    if form != "stack/json":
        place = metadata.value.get("content_type", metadata)
        message = f'unknown content_type "{form}": expected stack/json or stack/archive'
        raise Unreadable(error(place, message, "not-a-stack"))
    return read_sections(launch, ids=[name], ros2=True)


def _read_legacy(root: YamlNode) -> Stack:
    """Return an older stack with an `artifact`, which is an archive."""
    artifact = root.value.get("artifact")
    for key, remedy in ON_DEVICE.items():
        value = root.value.get(key)
        launches = key == "launch_description_source" and artifact is not None
        if value is not None and not is_empty(value) and not launches:
            message = f"`{key}` runs a file of a device, which no pod has: {remedy}"
            raise Unreadable(error(value, message, "needs-image", key=True))
    artifact = _descend(root, "artifact")
    launch_file = root.value.get("launch_description_source")
    more = {} if launch_file is None else {"launch_file": launch_file}
    values = {key: value for key, value in artifact.value.items() if key != "type"}
    return _make_archive(name_at(root.value, "name"), root, Archive(artifact, {**values, **more}))


def _make_archive(name: str, root: YamlNode, archive: Archive) -> Stack:
    """Return a stack of sources; both forms of them are ROS 2's."""
    ids = tuple(filter(None, (name_at(root.value, "stackId"), name)))
    return Stack(ids, name, root, archive=archive, ros2=True)


def _read_solution(root: YamlNode) -> Stack:
    """Return a Symphony solution as one stack of all its components that are stacks."""
    components = _descend(root, "spec").value.get("components")
    if components is None or not isinstance(components.value, list):
        raise Unreadable(error(root.value["spec"], UNKNOWN, "not-a-stack", key=True))
    if len(components.value) > MOST_COMPONENTS:
        message = f"this solution has more than {MOST_COMPONENTS} components"
        raise Unreadable(error(components, message, "too-large", key=True))
    parts: list[Stack] = []
    remarks = []
    for item in components.value:
        content = item.value if isinstance(item.value, dict) else {}
        properties = content.get("properties")
        found = properties.value if properties else None
        if properties and isinstance(found, dict) and text_at(found, "type") == "stack":
            parts += _read_component(name_at(content, "name"), properties)
        else:
            remarks.append(_lose_component(item))
    if not parts:
        message = "no component of this solution is a stack: expected properties.type: stack"
        raise Unreadable(error(components, message, "not-a-stack", key=True))
    metadata = root.value.get("metadata")
    named = metadata is not None and not is_empty(metadata)
    name = name_at(_descend(root, "metadata").value, "name") if named else ""
    return Stack(
        tuple(filter(None, [name])),
        name,
        root,
        parts=tuple(parts),
        remarks=tuple(remarks),
        ros2=any(part.ros2 for part in parts),
    )


def _lose_component(item: YamlNode) -> Remark:
    """Return that a component of another type is not carried over."""
    content = item.value if isinstance(item.value, dict) else {}
    name, form = text_at(content, "name"), text_at(content, "type")
    what = f'the component "{name}"' if name else "this component"
    other = f" is of the type {form}, not a stack" if form else " is not a stack"
    return loss(item, f"{what}{other}, and is not carried over: deploy it on its own")


def _read_component(name: str, properties: YamlNode) -> tuple[Stack, ...]:
    """Return the stacks of a component; `data` is text in base64, or the stack itself."""
    data = properties.value.get("data")
    if data is None:
        message = f'the component "{name}" has no data'
        raise Unreadable(error(properties, message, "not-a-stack", key=True))
    inner = data if isinstance(data.value, dict) else read(decode(data, f"component {name}"))
    if isinstance(inner.value, dict) and "spec" in inner.value:
        message = "a component of a solution cannot be a solution"
        raise Unreadable(error(inner.value["spec"], message, "not-a-stack", key=True))
    return list_stacks(inner)


def _descend(root: YamlNode, *keys: str) -> YamlNode:
    """Return the mapping below some keys. Raises Unreadable without one."""
    node = root
    for key in keys:
        below = node.value.get(key)
        if below is None or not isinstance(below.value, dict):
            message = f"there is no mapping {'.'.join(keys)} here: {UNKNOWN}"
            raise Unreadable(error(below or node, message, "not-a-stack", key=True))
        node = below
    return node
