"""What the tags of both generations share: arguments, includes and nodes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

import attrs

from rigel_import.draft import Place, Remark
from rigel_import.launch.entities import Entity, read_file
from rigel_import.launch.expressions import LeftOut
from rigel_import.launch.parameters import Options
from rigel_import.launch.scope import Arguments, Scope, Tags, join
from rigel_k8s.errors import RigelK8sError, UserError

#: Tags, and attributes of nodes, that are not carried over, with what to do.
LOST = {
    "cwd": "set WORKDIR in the image",
    "executable": "write it as a node with `ros: none` and `args`",
    "env": "set it in a group around the `include`",
    "launch-prefix": "write the whole line as `args`, without `package` and `executable`",
    "lifecycle_node": "write it as a node with `lifecycle: { start: [configure, activate] }`",
    "load_composable_node": "write its nodes as `components` of the container",
    "machine": "set `placement: { node: NAME }`",
    "on_exit": "Kubernetes starts this node again, and stops no other one",
    "required": "Kubernetes starts this node again, and stops no other one",
    "ros_args": "add its words to `args`",
    "set_use_sim_time": "set `parameters: { use_sim_time: true }` of the nodes",
}
UNNAMED: Options = {"anonymous": True, "update": {"strategy": "Recreate"}}
NO_NAME = "it has no fixed name; if you know it, set it, without `anonymous` and `update`"
#: Tags without an effect on a cluster.
IGNORED = ("log", "log_info", "machine", "test")


def take(scope: Scope, entities: Iterable[Entity], tags: Tags) -> None:
    """Do what tags mean, in their order; one that is left out becomes a remark."""
    for entity in entities:
        try:
            if not scope.is_true(entity, "if", "true") or scope.is_true(entity, "unless"):
                continue
            if entity.tag in tags:
                tags[entity.tag](scope, entity)
            elif entity.tag not in IGNORED:
                scope.remark(entity.place, describe_lost(entity.tag))
        except (LeftOut, RecursionError) as error:
            scope.remark(entity.place, f"`{entity.tag}` is left out: {error}")


def describe_lost(name: str) -> str:
    """Return the remark about a tag or attribute that is not carried over."""
    return f"`{name}` is not carried over: {LOST.get(name, 'set options of nodes for it')}"


# Arguments and environment variables


def set_argument(scope: Scope, entity: Entity) -> None:
    """Set an argument to its `value`; to its `default` if it has no value yet."""
    name = scope.read_known(entity, "name")
    scope.robot.declared.add(name)
    if "value" in entity.values:
        scope.arguments[name] = read_argument(scope, entity, "value")
    elif name not in scope.arguments:
        if "default" not in entity.values:
            message = f'{entity.place}: the argument "{name}" has no value'
            raise UserError(message, hint=f"pass --arg {name}=VALUE")
        scope.arguments[name] = read_argument(scope, entity, "default")


def read_argument(scope: Scope, entity: Entity, key: str) -> str | None:
    """Return the value of an argument; None, with a remark, if it is not known here."""
    try:
        return scope.read(entity, key)
    except LeftOut as error:
        scope.remark(entity.place, f"`{entity.tag}` has a value that is not known here: {error}")
        return None


def set_env(scope: Scope, entity: Entity) -> None:
    """Set an environment variable of nodes."""
    name = scope.read_known(entity, "name")
    scope.options.setdefault("env", {})[name] = scope.read(entity, "value")


# Includes


def read_passed(scope: Scope, entity: Entity) -> Arguments:
    passed: Arguments = {}

    def add(scope: Scope, arg: Entity) -> None:
        key = "value" if "value" in arg.values else "default"
        passed[scope.read_known(arg, "name")] = read_argument(scope, arg, key)

    take(scope, entity.children, {"arg": add, "let": add})
    return passed


def include(scope: Scope, entity: Entity, text: str, passed: Arguments) -> None:
    """Take the tags of an included file; one that cannot be read or evaluated becomes a node.

    Args:
        scope: that of the file's tags.
        text: the file, as in `$(find robot)/launch/a.launch`.
        passed: the arguments that it is passed.
    """
    match = re.fullmatch(r"\$\((?:find|find-pkg-share) (\S+)\)/+([^$]+)", text)
    if match is None and "$(" in text:
        raise LeftOut(f"only a container knows `{text}`: write its path")
    package, path = match.groups() if match else ("", text)
    directory = scope.robot.packages.get(package) if match else scope.robot.files[-1].parent
    file = directory / path if directory else None
    if path.endswith(".py"):
        reason = "it is in Python, and was not evaluated without --image"
        if scope.robot.take_python:
            here = str(file.resolve()) if file and file.is_file() else text
            try:
                scope.robot.take_python(scope, [here])
                return
            except RigelK8sError as error:
                reason = f"it was not evaluated: {error.message}"
        if match is None:
            raise LeftOut(reason)
    elif file and (match is None or file.is_file()):
        follow(scope, file)
        return
    else:
        reason = f"it is not here; to read it, pass --package {package}=DIRECTORY"
    launch: Options = {"package": package, "file": PurePosixPath(path).name}
    if args := {name: value for name, value in passed.items() if value is not None}:
        launch["args"] = args
    keep(scope, entity.place, launch, reason)


def follow(scope: Scope, file: Path) -> None:
    """Take the tags of a file. Raises UserError if it is unreadable or includes itself."""
    robot = scope.robot
    if file.resolve() in (path.resolve() for path in robot.files):
        chain = " -> ".join(path.name for path in (*robot.files, file))
        raise UserError(f"{file}: it includes itself: {chain}", hint="remove one `include`")
    root = read_file(file)
    robot.files.append(file)
    take(scope, root.children, robot.tags)
    robot.files.pop()


def keep(scope: Scope, place: Place, launch: Options, reason: str) -> None:
    """Add a node that starts a launch file, of which it gets the options, and why."""
    file = launch["file"]
    message = f"{file} stays a launch file, in one pod: {reason}"
    message += "; it does not get the parameters and remappings that are set around it"
    name = file.split(".")[0].replace("-", "_")
    if scope.robot.ros == "1":
        name = join(scope.namespace, name)
    elif scope.namespace:
        message += f", nor the namespace {scope.namespace}"
    inner = scope.copy(remarks=[Remark(place, message)])
    add_options(inner, place, name, {"launch": launch, "env": inner.options.get("env", {})})


# Nodes


def add_node(scope: Scope, entity: Entity, executable: str, namespace: str, tags: Tags) -> None:
    """Add a node.

    Args:
        executable: the attribute with its executable.
        namespace: the attribute with its namespace.
        tags: what each tag in it does.
    """
    options: Options = {"package": scope.read_known(entity, "pkg")}
    options["executable"] = scope.read_known(entity, executable)
    options["args"] = scope.read(entity, "args", "").strip()
    default = re.sub(r"\W", "_", PurePosixPath(options["executable"]).stem)
    below = scope.read_known(entity, namespace, "")
    name = join(scope.namespace, below, scope.read_known(entity, "name", default))
    inner = scope.copy(remarks=[], node=name)
    if "name" not in entity.values or "$(anon" in entity.values["name"]:
        inner.node = None
        options |= UNNAMED
        inner.remark(entity.place, NO_NAME)
    take(inner, entity.children, tags)
    for key in LOST:
        if inner.read(entity, key, "").lower() not in ("false", "0", ""):
            inner.remark(entity.place, describe_lost(key))
    add_options(inner, entity.place, name, options | inner.options)


def add_options(scope: Scope, place: Place, name: str, options: Options) -> None:
    """Add a node with its options, and the remarks of its scope."""
    nodes = scope.robot.nodes
    key, number = name, 2
    while key in nodes:
        key, number = f"{name}_{number}", number + 1
    if key != name:
        scope.remark(place, f"`{name}` is already a node, so this one is `{key}`")
    nodes[key] = options
    scope.robot.remarks += [attrs.evolve(remark, node=key) for remark in scope.remarks]
