"""The tags of roslaunch."""

from __future__ import annotations

import re

from rigel_import.launch.actions import add_node, include, read_passed, set_argument, set_env, take
from rigel_import.launch.entities import Entity
from rigel_import.launch.expressions import LeftOut
from rigel_import.launch.parameters import Options, put, read_typed, read_yaml
from rigel_import.launch.scope import Scope, join
from rigel_k8s.errors import UserError


def take_group(scope: Scope, entity: Entity) -> None:
    namespace = join(scope.namespace, scope.read_known(entity, "ns", ""))
    take(scope.copy(namespace=namespace), entity.children, TAGS)


def take_include(scope: Scope, entity: Entity) -> None:
    """Take the tags of another file, which only has the arguments that it is passed."""
    namespace = join(scope.namespace, scope.read_known(entity, "ns", ""))
    passed = dict(scope.arguments) if scope.is_true(entity, "pass_all_args") else {}
    passed |= read_passed(scope, entity)
    inner = scope.copy(namespace=namespace, arguments=passed)
    include(inner, entity, scope.read(entity, "file"), passed)


def remap(scope: Scope, entity: Entity) -> None:
    """Rename a topic or service of nodes."""
    old, new = scope.read_known(entity, "from"), scope.read_known(entity, "to")
    scope.options.setdefault("remappings", {})[old] = new


def set_param(scope: Scope, entity: Entity) -> None:
    """Set a global parameter, or one of the nodes that follow: `~rate`."""
    name = scope.read_known(entity, "name")
    if name.startswith("~"):
        _set_param(scope, entity, name[1:], scope.options)
    else:
        _set_param(scope, entity, join(scope.namespace, name), scope.robot.options)


def set_node_param(scope: Scope, entity: Entity) -> None:
    """Set a parameter of a node, or a global one: `/rate`."""
    name = scope.read_known(entity, "name")
    options = scope.robot.options if name.startswith("/") else scope.options
    _set_param(scope, entity, name.strip("~/"), options)


def _set_param(scope: Scope, entity: Entity, name: str, options: Options) -> None:
    """Set a parameter: a value, a file's text, or what a command prints."""
    if "binfile" in entity.values:
        raise LeftOut("a binary file cannot be a parameter")
    if "command" in entity.values:
        command = " ".join(scope.read(entity, "command").split())
        put(options, "parameter_commands", name, command)
    elif "textfile" in entity.values:
        put(options, "parameter_commands", name, f"cat {scope.read(entity, 'textfile')}")
    else:
        kind = scope.read_known(entity, "type", "auto")
        value = read_typed(scope.read(entity, "value"), kind, entity.place)
        put(options, "parameters", name, value)


def load(scope: Scope, entity: Entity, above: str, options: Options) -> None:
    """Set the parameters of a `rosparam`: those of a file of the image, or its own text."""
    if (command := scope.read_known(entity, "command", "load")) != "load":
        raise LeftOut(f"`command` is {command}, not load")
    names = (scope.read_known(entity, key, "").removeprefix("~") for key in ("ns", "param"))
    name = join(above, *names)
    substitutes = scope.is_true(entity, "subst_value")
    if "file" in entity.values:
        file = {"image_file": scope.read(entity, "file")} | ({"namespace": name} if name else {})
        scope.add_file(entity, options, file)
        if substitutes:
            scope.remark(entity.place, "expressions in this file are not replaced (subst_value)")
        return
    text = scope.resolve(entity.text, entity.place) if substitutes else entity.text
    if re.search(r"!(degrees|radians)\b|\b(deg|rad)\(", text):
        raise LeftOut("roslaunch computes angles in it: write them as numbers")
    value = read_yaml(text, entity.place)
    if name:
        put(options, "parameters", name, value)
    elif isinstance(value, dict):
        for key, inner in value.items():
            put(options, "parameters", key, inner)
    elif value is not None:
        hint = 'set `param="NAME"`, or write `NAME: VALUE`'
        raise UserError(f"{entity.place}: this value has no name", hint=hint)


def take_node(scope: Scope, entity: Entity) -> None:
    """Add a node; a nodelet is a node that loads it into its manager."""
    if entity.values.get("type") == "nodelet" and "load " in entity.values.get("args", ""):
        message = "write this nodelet as one of its manager's `components` to start both together"
        scope.remark(entity.place, message)
    add_node(scope, entity, "type", "ns", NODE_TAGS)


NODE_TAGS = {
    "env": set_env,
    "param": set_node_param,
    "remap": remap,
    "rosparam": lambda scope, entity: load(scope, entity, "", scope.options),
}
TAGS = {
    "arg": set_argument,
    "env": set_env,
    "group": take_group,
    "include": take_include,
    "node": take_node,
    "param": set_param,
    "remap": remap,
    "rosparam": lambda scope, entity: load(scope, entity, scope.namespace, scope.robot.options),
}
