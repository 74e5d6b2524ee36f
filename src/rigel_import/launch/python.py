"""Launch files in Python as nodes: what evaluator.py has found, in the words of a Rigelfile."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import attrs
import yaml

from rigel_import.draft import Place
from rigel_import.launch.actions import NO_NAME, UNNAMED, add_options, describe_lost
from rigel_import.launch.evaluation import evaluate, make_place
from rigel_import.launch.evaluator import MARK
from rigel_import.launch.expressions import LeftOut
from rigel_import.launch.packages import find_workspace
from rigel_import.launch.parameters import Options, put
from rigel_import.launch.ros2 import name_component, read_plain, remap_private
from rigel_import.launch.scope import Scope, join
from rigel_k8s.app.components import dotted
from rigel_k8s.app.generations.ros2files import ANY_NODE, PARAMETERS, matches
from rigel_k8s.errors import UserError
from rigel_k8s.ros import ROS_ARGS, ROS_ARGS_END
from rigel_k8s.yaml_text import Loader

LIFECYCLE = (
    "it is a lifecycle node, whose transitions in the launch file are not carried over: unless a"
    " lifecycle manager makes them, set `lifecycle: { start: [configure, activate] }`"
)
NO_ROS = "it is taken for a program without ROS; if it has ROS nodes, leave `ros: none` out"
#: A path in a text, with what must be before it.
PATH = re.compile(r"""(?<![^\s:=,'"])/[^\s:,'"]+""")


def take_python(scope: Scope, words: Sequence[str], image: str) -> None:
    """Add what a launch file in Python starts in a scope.

    Args:
        words: its path, or its package and name; with the expressions of ROS 2.
        image: the image in which it is evaluated.
    """
    around = {"namespace": scope.namespace}
    around |= {key: scope.options.get(key, {}) for key in ("env", "parameters", "remappings")}
    request = {
        "file": list(words),
        "arguments": {key: text for key, text in scope.arguments.items() if text is not None},
        "around": around,
    }
    folders = [*scope.robot.packages.values()]
    folders += [find_workspace(file) for file in map(Path, words) if file.is_file()]
    take_document(scope, evaluate(request, image, folders))


def take_document(scope: Scope, document: Mapping[str, Any]) -> None:
    """Add what an evaluation has found."""
    here = {str(path.resolve()): name for name, path in scope.robot.packages.items()}
    evaluated = Evaluated(document, {**document["shares"], **here})
    scope.robot.declared |= {*document["arguments"]}
    for remark in document["remarks"]:
        scope.remark(Place(*make_place(remark["place"])), remark["message"])
    for process in document["processes"]:
        take_process(scope, evaluated, process)
    for component in document["components"]:
        take_component(scope, evaluated, component)


@attrs.frozen
class Evaluated:
    """A document, and the names of packages by their directories."""

    document: Mapping[str, Any]
    shares: Mapping[str, str]

    def make_portable(self, value: Any) -> Any:
        """Return plain data in which the paths of packages begin with `$(find-pkg-share ...)`."""
        if isinstance(value, Mapping):
            return {key: self.make_portable(item) for key, item in value.items()}
        if isinstance(value, list):
            return [self.make_portable(item) for item in value]
        if not isinstance(value, str) or "$(" in value or "<" in value:
            return value  # "<": XML, in which a path is not the word's start
        return PATH.sub(lambda match: self._name_package(match[0]), value)

    def _name_package(self, text: str) -> str:
        path = PurePosixPath(text)
        for folder in (path, *path.parents):
            if name := self.shares.get(str(folder)):
                return f"$(find-pkg-share {name}){text[len(str(folder)) :]}"
        return text

    def find_file(self, file: str) -> Options | None:
        """Return a parameter file as one of the image; None: it is of this computer, or made."""
        portable = self.make_portable(file)
        made = file.startswith(f"{self.document['temporary']}/")
        if portable == file and (made or Path(file).exists()):
            return None
        return {"image_file": portable}


# Processes


@attrs.define
class Line:
    """A command line by the meaning of its words.

    Attributes:
        remappings: the first one of each name, as rcl takes them.
        parameters: in their order: ("name:=value", "") or ("", a file).
    """

    args: list[str] = attrs.field(factory=list)
    remappings: dict[str, str] = attrs.field(factory=dict)
    parameters: list[tuple[str, str]] = attrs.field(factory=list)


def read_line(words: Sequence[str]) -> Line:
    """Return what the arguments of a ROS program mean; those with no other place stay `args`."""
    line, ros, kept = Line(), False, []
    rest = iter(words)
    for word in rest:
        if word in (ROS_ARGS, ROS_ARGS_END):
            ros = word == ROS_ARGS
        elif not ros:
            line.args.append(word)
        elif word in ("-r", "--remap"):
            old, _, new = next(rest).partition(":=")
            line.remappings.setdefault(old, new)
        elif word == "--params-file":
            line.parameters.append(("", next(rest)))
        elif word in ("-p", "--param") and ":" not in (text := next(rest)).split(":=")[0]:
            line.parameters.append((text, ""))
        else:
            kept += [word, text] if word in ("-p", "--param") else [word]
    line.args += [ROS_ARGS, *kept] if kept else []
    return line


def take_process(scope: Scope, evaluated: Evaluated, process: Mapping[str, Any]) -> None:
    """Add a process as a node, or as a program without ROS."""
    place = Place(*make_place(process["place"]))
    words = process["command"]
    inner = scope.copy(remarks=[], options={}, namespace="")
    start = next((i for i, word in enumerate(words) if word.startswith(MARK)), None)
    if start is None and ROS_ARGS not in words:
        name, options = take_program(inner, place, process)
    else:
        options = {}
        if start is not None:
            _, options["package"], options["executable"], _ = words[start].split(MARK)
        line = read_line(words if start is None else words[start + 1 :])
        default = options.get("executable") or process["name"]
        namespace = line.remappings.pop("__ns", "")
        given = line.remappings.pop("__node", None)
        name = join(namespace, given or make_name(PurePosixPath(default).stem))
        options["args"] = write_words(evaluated.make_portable(line.args))
        if given is None:
            options |= UNNAMED
            inner.remark(place, NO_NAME)
        inner.node = name if given else None
        add_parameters(inner, evaluated, line, name, process)
        for old, new in line.remappings.items():
            add_remapping(inner, place, old, new)
        if start:
            inner.remark(place, describe_lost("launch-prefix"))
    if env := process["env"]:
        options["env"] = env if "ros" in options else evaluated.make_portable(env)
    made = f"{evaluated.document['temporary']}/"
    if made in str(options["args"]):
        inner.remark(place, f"what the launch file itself writes to {made} is not in the pod")
    for key in process["lost"]:
        inner.remark(place, LIFECYCLE if key == "lifecycle_node" else describe_lost(key))
    add_waiting(inner, place, process["waiting"])
    add_options(inner, place, name, options | inner.options)


def take_program(scope: Scope, place: Place, process: Mapping[str, Any]) -> tuple[str, Options]:
    """Return the name and options of a process that is not started as a ROS node."""
    words = process["command"]
    args = ["sh", "-c", " ".join(words)] if process["shell"] else write_words(words)
    if PurePosixPath(words[0]).name == "ros2":
        scope.remark(place, NO_NAME)
        return make_name(process["name"]), {"args": args, **UNNAMED}
    scope.remark(place, NO_ROS)
    return make_name(process["name"]), {"ros": "none", "args": args}


def add_remapping(scope: Scope, place: Place, old: str, new: str) -> None:
    """Add a remapping of a node; one that needs a name that is not known becomes a remark."""
    try:
        remap_private(scope, old, new)
    except LeftOut as error:
        scope.remark(place, f"`remap` is left out: {error}")


def make_name(text: str) -> str:
    """Return a program's name as one of ROS."""
    return re.sub(r"\W", "_", text)


def write_words(words: list[str]) -> str | list[str]:
    """Return words as one text, if splitting it gives them again."""
    plain = all(re.fullmatch(r"[\w@%+=:,./-]+", word) for word in words)
    return " ".join(words) if plain else words


def add_waiting(scope: Scope, place: Place, waiting: Sequence[str]) -> None:
    """Add a remark about what the launch file waits for."""
    for reason in waiting:
        scope.remark(place, f"the launch file starts it after {reason}; here it starts at once")


# Parameters


def add_parameters(
    scope: Scope, evaluated: Evaluated, line: Line, name: str, process: Mapping[str, Any]
) -> None:
    """Set a node's parameters: values, files of the image, and files beside the Rigelfile.

    Values come after files in a Rigelfile: one that a later file replaces is left out.

    Args:
        name: the node's name, which the program may replace if the scope has none.
    """
    files, place = process["files"], Place(*make_place(process["place"]))
    values: Options = {}
    full = f"/{name}" if scope.node else None
    for assignment, file in line.parameters:
        if not file:
            key, _, text = assignment.partition(":=")
            values[key] = read_plain(text, place)
            continue
        sections = read_sections(files[file], file, place)
        parts = [part for key, part in sections if key == ANY_NODE or matches(key, full)]
        own = {key: value for part in parts for key, value in dotted(part)}
        entry = evaluated.find_file(file)
        if entry is None and len(parts) == len(sections):
            values |= own
            continue
        values = {key: value for key, value in values.items() if key not in own}
        kept = entry or add_text(scope.robot.texts, PurePosixPath(name).name, files[file])
        scope.options.setdefault("parameter_files", []).append(kept)
    commands = evaluated.document["commands"]
    for key, value in values.items():
        if isinstance(value, str) and "\n" in value and value in commands:
            words = evaluated.make_portable(commands[value]).split()
            put(scope.options, "parameter_commands", key, " ".join(words))
        elif value is None or value == []:
            scope.remark(place, f"the parameter `{key}` has no value, and is left out")
        else:
            put(scope.options, "parameters", *nest(key, evaluated.make_portable(value)))


class ParameterLoader(Loader):  # type: ignore[misc]  # Any: with or without LibYAML
    """Reads the parameter files that launch_ros writes, whose lists are tuples."""


ParameterLoader.add_constructor(
    "tag:yaml.org,2002:python/tuple", lambda loader, node: loader.construct_sequence(node)
)


def read_sections(text: str, file: str, place: Place) -> list[tuple[str, Options]]:
    """Return the key of each node in a parameter file, with its parameters.

    rcl reads a key that is there twice as one, a YAML parser as the second only.
    """
    loader = ParameterLoader(text)

    def find(node: Any, above: str) -> Iterator[tuple[str, Options]]:
        for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
            if key.value == PARAMETERS:
                yield above or ANY_NODE, loader.construct_object(value, deep=True) or {}
            else:
                yield from find(value, f"{above}/{key.value.strip('/')}")

    try:
        return list(find(loader.get_single_node(), ""))
    except yaml.YAMLError as error:
        message = f"{place}: {file} is invalid YAML: {' '.join(str(error).split())}"
        raise UserError(message, hint="correct the file") from None


def nest(name: str, value: Any) -> tuple[str, Any]:
    """Return the first key of a parameter's full name, and what belongs to it."""
    first, *below = name.split(".")
    for key in reversed(below):
        value = {key: value}
    return first, value


def add_text(texts: dict[str, str], name: str, text: str) -> str:
    """Keep a parameter file for beside the Rigelfile; return its path. Equal ones are one."""
    for path, other in texts.items():
        if other == text:
            return path
    path = f"parameters/{name}.yaml"
    while path in texts:
        path = path.replace(".yaml", "_.yaml")
    texts[path] = text
    return path


# Components


def take_component(scope: Scope, evaluated: Evaluated, component: Mapping[str, Any]) -> None:
    """Add a component to its container, which was found before."""
    place = Place(*make_place(component["place"]))
    plugin, container = component["plugin"], component["container"].strip("/")
    inner = scope.copy(remarks=[], options={})
    name = component["name"] or name_component(inner, place, plugin)
    key = join(component["namespace"], name)
    options = scope.robot.nodes.get(container)
    if options is None or "launch" in options:
        message = f"`{key}` is not carried over: its container `{container}` is not started here"
        scope.remark(place, message)
        return
    inner.node = key
    for text in component["remappings"]:
        old, _, new = text.partition(":=")
        add_remapping(inner, place, old, new)
    for option in ("parameters", "extra_arguments"):
        for full, value in component[option].items():
            put(inner.options, option, *nest(full, evaluated.make_portable(value)))
    add_waiting(inner, place, component["waiting"])
    entry = {"package": component["package"], "plugin": plugin, **inner.options}
    options.setdefault("components", {})[key] = entry
    scope.robot.remarks += [attrs.evolve(remark, node=container) for remark in inner.remarks]
