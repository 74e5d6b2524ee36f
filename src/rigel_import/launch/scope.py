"""What holds at one place of a launch file, and what its texts mean there.

What only a container knows stays, in the form that `substitution_args` replaces: `$(find robot)`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import attrs

from rigel_import.draft import Place, Remark
from rigel_import.launch.entities import Entity, as_text
from rigel_import.launch.expressions import LeftOut, evaluate, replace_expressions
from rigel_import.launch.packages import find_package
from rigel_import.launch.parameters import Options, as_number
from rigel_k8s.errors import UserError
from rigel_k8s.option_text import split_text
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.rigelfile.limits import LONGEST_TEXT
from rigel_k8s.substitution_args import EXPRESSION, is_substituted

#: The values of arguments by name; None: a value that is not known here.
Arguments = dict[str, str | None]
#: How ROS writes true and false.
TRUTHS = {"true": True, "1": True, "false": False, "0": False}


@attrs.define
class Robot:
    """What launch files describe; it grows while they are read.

    Attributes:
        ros: the generation of ROS, "1" or "2".
        tags: what each tag of a file or group does.
        packages: the directories of packages that are here, by name.
        files: the launch files that are open now, each included by the one before.
        declared: the names of all arguments.
        nodes: the options of each node, by key.
        options: the options of the job.
        texts: parameter files that are written beside the Rigelfile, by their paths.
        take_python: adds what a launch file in Python starts; None: it is not evaluated.
    """

    ros: str
    tags: Tags
    packages: Mapping[str, Path]
    files: list[Path] = attrs.field(factory=list)
    declared: set[str] = attrs.field(factory=set)
    nodes: dict[str, Options] = attrs.field(factory=dict)
    options: Options = attrs.field(factory=dict)
    remarks: list[Remark] = attrs.field(factory=list)
    texts: dict[str, str] = attrs.field(factory=dict)
    take_python: Callable[[Scope, Sequence[str]], None] | None = None


@attrs.define
class Scope:
    """What holds for the tags that follow in a file, a group or a node.

    Attributes:
        namespace: without a slash at its start and end.
        node: the full name of the node whose scope it is; None: it has none, or is not of a node.
        options: what each node gets: `env`, `remappings`, `parameters` and the like.
        remarks: those of the job, or of the node whose scope it is.
    """

    robot: Robot
    arguments: Arguments
    remarks: list[Remark]
    namespace: str = ""
    node: str | None = None
    options: Options = attrs.field(factory=dict)

    def copy(self, **changes: Any) -> Scope:
        """Return a scope whose arguments and options may change without those of this one."""
        copies = {"arguments": dict(self.arguments), "options": deepcopy(self.options)}
        return attrs.evolve(self, **(copies | changes))

    def remark(self, place: Place, message: str) -> None:
        """Add a remark about the job, or about the node whose scope it is."""
        self.remarks.append(Remark(place, message))

    def add_file(self, entity: Entity, options: Options, file: Options) -> None:
        """Add a parameter file, after which a Rigelfile has its values, whatever comes first."""
        above = file.get("namespace", "")
        if any(name.startswith(above) for name in options.get("parameters", ())):
            self.remark(entity.place, "values before this file win here, not its own: remove them")
        options.setdefault("parameter_files", []).append(file)

    def read(self, entity: Entity, key: str, default: str | None = None) -> str:
        """Return an attribute, with the expressions that only a container replaces.

        Raises:
            UserError: it is missing and has no default, or uses an argument that does not exist.
            LeftOut: it has another expression.
        """
        value = entity.values.get(key, default)
        if value is None:
            message = f'{entity.place}: `{entity.tag}` needs the attribute "{key}"'
            raise UserError(message, hint=f"add {key}")
        return self.resolve(as_text(value), entity.place)

    def read_known(self, entity: Entity, key: str, default: str | None = None) -> str:
        """Return an attribute that must be known before anything runs. Raises as `read` does."""
        return self._settle(self.read(entity, key, default), entity.place).strip()

    def is_true(self, entity: Entity, key: str, default: str = "false") -> bool:
        """Return whether an attribute is true. Raises as `read` does, and for other values."""
        text = self.read_known(entity, key, default)
        if text.lower() not in TRUTHS:
            message = f'{entity.place}: "{key}" must be true, false, 1 or 0, got "{text}"'
            raise UserError(message, hint="correct it, or pass its argument with --arg")
        return TRUTHS[text.lower()]

    def resolve(self, text: str, place: Place) -> str:
        """Return a text with only those expressions that a container replaces. Raises as `read`."""
        resolved = replace_expressions(text, lambda inside: self._replace(inside, place))
        if len(resolved) > LONGEST_TEXT:
            raise LeftOut(f"a text becomes longer than {LONGEST_TEXT} characters")
        return resolved

    def _replace(self, inside: str, place: Place) -> str:
        inner = self.resolve(inside, place)
        word, _, rest = inner.strip().partition(" ")
        if word == "eval":
            expression = self._settle(rest, place)
            return str(evaluate(expression, lambda name: self._get_number(name, place)))
        try:
            words = split_text(rest)
        except ValueError as error:
            raise LeftOut(f"`$({inner})`: {error}") from None
        match word, words:
            case "var", [name, other] if name not in self.arguments:
                return other
            case "arg" | "var", [name] | [name, _]:
                return self._get(name, place)
            case ("not", [_]) | ("and" | "or", [_, _]):
                expression = f" {word} ".join(words) if len(words) > 1 else f"not {words[0]}"
                return self._replace(f"eval {expression.lower()}", place)
            case "anon", [name]:
                return name
            case "dirname", []:
                return self._find_dirname()
            case "env", [name, ""]:
                return f"$(optenv {name})"
        expression = f"$({' '.join([word, *words])})"
        if "$(" in inner or not is_substituted(expression):
            raise LeftOut(f"a container cannot replace `$({inner})`: write its value")
        return expression

    def _find_dirname(self) -> str:
        """Return the open file's directory as a container finds it: `$(find robot)/launch`."""
        file = self.robot.files[-1].resolve()
        package = find_package(file)
        if package is None:
            raise LeftOut("`$(dirname)` needs a package.xml in a directory above this file")
        return f"$(find {package[0]})/{file.parent.relative_to(package[1]).as_posix()}"

    def _get(self, name: str, place: Place) -> str:
        """Return the value of an argument."""
        if name not in self.arguments:
            message = f'{place}: unknown argument "{name}"{suggest(name, self.arguments)}'
            raise UserError(message, hint="declare it with `arg`, or correct its name")
        value = self.arguments[name]
        if value is None:
            raise LeftOut(f"the argument `{name}` is not known here; set it with --arg")
        return value

    def _get_number(self, name: str, place: Place) -> Any:
        """Return the value of an argument in `$(eval ...)`."""
        if name not in self.arguments:
            raise LeftOut(f"`$(eval ...)` uses `{name}`, which is not an argument")
        return as_number(self._settle(self._get(name, place), place))

    def _settle(self, text: str, place: Place) -> str:
        """Return a text with the defaults of variables, since it must be known now."""

        def take_default(match: re.Match[str]) -> str:
            word, *words = match[1].split()
            if word != "optenv" and len(words) < 2:
                raise LeftOut(f"only a container knows `{match[0]}`; pass --arg, or edit the file")
            message = f"`{match[0]}` is taken as its default; edit the file for another value"
            self.remark(place, message)
            return " ".join(words[1:])

        return EXPRESSION.sub(take_default, text)


def join(*names: str) -> str:
    """Return ROS names below each other, without a leading slash; an absolute one starts again."""
    start = max((i for i, name in enumerate(names) if name.startswith("/")), default=0)
    return "/".join(filter(None, (name.strip("/") for name in names[start:])))


#: What each tag does.
Tags = Mapping[str, Callable[[Scope, Entity], None]]
