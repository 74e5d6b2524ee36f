"""The actions of ros2 launch, in XML and in YAML."""

from __future__ import annotations

import re
from typing import Any

from rigel_import.draft import Place
from rigel_import.launch.actions import add_node, include, read_passed, set_argument, set_env, take
from rigel_import.launch.entities import Entity, as_text
from rigel_import.launch.expressions import LeftOut
from rigel_import.launch.parameters import Options, put, read_yaml
from rigel_import.launch.scope import Scope, join
from rigel_k8s.errors import UserError

#: The value of a parameter that a program prints.
COMMAND = re.compile(r"""\s*\$\(command\s+(['"])(.+?)\1(\s+['"]?\w+['"]?)?\s*\)\s*""", re.S)


def take_group(scope: Scope, entity: Entity) -> None:
    """Take the actions of a group, or of a timer at once; by default their settings end there."""
    inner = scope.copy() if scope.is_true(entity, "scoped", "true") else scope
    take(inner, entity.children, TAGS)


def take_include(scope: Scope, entity: Entity) -> None:
    """Take the actions of another file. Its settings last, as in ros2 launch."""
    file = scope.read(entity, "file")
    passed = read_passed(scope, entity)
    scope.arguments |= passed
    include(scope, entity, file, passed)


def push_namespace(scope: Scope, entity: Entity) -> None:
    """Put the nodes that follow into a namespace."""
    name = scope.read_known(entity, "namespace", entity.text)
    scope.namespace = join(scope.namespace, name)


def remap(scope: Scope, entity: Entity) -> None:
    remap_private(scope, scope.read_known(entity, "from"), scope.read_known(entity, "to"))


def remap_private(scope: Scope, old: str, new: str) -> None:
    """Rename a topic or service of nodes; private names, `~/in`, are written in full."""
    names = [old, new]
    for index, name in enumerate(names):
        if name.startswith("~/"):
            if scope.node is None:
                raise LeftOut(f"`{name}` needs the node's name")
            names[index] = f"/{scope.node}{name[1:]}"
    scope.options.setdefault("remappings", {}).setdefault(*names)


def set_param(scope: Scope, entity: Entity, option: str = "parameters") -> None:
    """Set a parameter: a value, nested ones, or what a command prints; or those of a file."""
    if "from" in entity.values:
        scope.add_file(entity, scope.options, {"image_file": scope.read(entity, "from")})
        if scope.is_true(entity, "allow_substs"):
            scope.remark(entity.place, "expressions in this file are not replaced (allow_substs)")
        return
    name = scope.read_known(entity, "name")
    if command := COMMAND.fullmatch(as_text(entity.values.get("value", ""))):
        line = scope.resolve(command[2], entity.place)
        put(scope.options, "parameter_commands", name, " ".join(line.split()))
    else:
        put(scope.options, option, name, read_value(scope, entity))


def read_value(scope: Scope, entity: Entity) -> Any:
    """Return the value of a parameter, or its nested parameters as a mapping."""
    value = entity.values.get("value")
    if value is None and entity.children:
        return {scope.read_known(e, "name"): read_value(scope, e) for e in entity.children}
    if isinstance(value, list):
        return [
            read_plain(scope.resolve(as_text(item), entity.place), entity.place) for item in value
        ]
    if value is not None and not isinstance(value, str):
        return value
    text = scope.read(entity, "value")
    if separator := entity.values.get("value-sep"):
        return [read_plain(part, entity.place) for part in text.split(separator)]
    return text if entity.values.get("type") == "str" else read_plain(text, entity.place)


def read_plain(text: str, place: Place) -> Any:
    """Return a text with the type that ros2 launch gives it."""
    if "$(" in text:
        return text
    try:
        value = read_yaml(text, place)
    except UserError:
        return text  # such as "a: b: c"
    return text if value is None or isinstance(value, dict) else value


def take_container(scope: Scope, entity: Entity) -> None:
    """Add a component container with its components, which do not have its own options."""

    def add(inner: Scope, child: Entity) -> None:
        components = inner.options.setdefault("components", {})
        add_component(scope.copy(remarks=inner.remarks), child, components)

    add_node(scope, entity, "exec", "namespace", {**NODE_TAGS, "composable_node": add})


def add_component(scope: Scope, entity: Entity, components: dict[str, Options]) -> None:
    """Add a composable node to the components of a container."""
    plugin = scope.read_known(entity, "plugin")
    if "name" in entity.values:
        name = scope.read_known(entity, "name")
    else:
        name = name_component(scope, entity.place, plugin)
    key = join(scope.namespace, scope.read_known(entity, "namespace", ""), name)
    scope.node = key
    take(scope, entity.children, COMPONENT_TAGS)
    if {"parameter_files", "parameter_commands"} & scope.options.keys():
        message = f"`{key}` gets no parameter files or commands; write them as `parameters`"
        scope.remark(entity.place, message)
    kept = ("parameters", "remappings", "extra_arguments")
    own = {option: scope.options[option] for option in kept if option in scope.options}
    components[key] = {"package": scope.read_known(entity, "pkg"), "plugin": plugin, **own}


def name_component(scope: Scope, place: Place, plugin: str) -> str:
    """Return a name for a component without one, with a remark."""
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", plugin.rsplit(":")[-1]).lower()
    scope.remark(place, f"{plugin} has no name in the launch file; it gets `{name}`")
    return name


NODE_TAGS = {"env": set_env, "param": set_param, "remap": remap}
COMPONENT_TAGS = {
    "extra_arg": lambda scope, entity: set_param(scope, entity, "extra_arguments"),
    "param": set_param,
    "remap": remap,
}
TAGS = {
    "arg": set_argument,
    "group": take_group,
    "include": take_include,
    "let": set_argument,
    "node": lambda scope, entity: add_node(scope, entity, "exec", "namespace", NODE_TAGS),
    "node_container": take_container,
    "push-ros-namespace": push_namespace,
    "push_ros_namespace": push_namespace,
    "set_env": set_env,
    "set_parameter": set_param,
    "set_remap": remap,
    "timer": take_group,
}
