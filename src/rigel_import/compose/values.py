"""Values of a Compose file, with their places and with `${VARIABLE}` filled in."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import attrs

from rigel_import.draft import VAR_END, VAR_START, Place, Remark, use_var
from rigel_import.text import read_text
from rigel_k8s.errors import UserError
from rigel_k8s.rigelfile.source import YamlNode

#: `$$`, `$NAME`, `${NAME}` and `${NAME:-default}`; a default may contain one more `${NAME}`.
REFERENCE = re.compile(
    r"\$(?:(?P<dollar>\$)|(?P<bare>[A-Za-z_]\w*)"
    r"|\{(?P<name>[A-Za-z_]\w*)(?:(?P<kind>:?[-?+])(?P<other>(?:[^{}]|\{[^{}]*\})*))?\})"
)
USED_VAR = re.compile(f"{VAR_START}(.*?){VAR_END}")
#: A value with one of these does not become a var: a command is split at them, `~` is a directory.
NO_VAR = re.compile(r"[\s'\"\\$~]|^\.$")
#: A line `NAME=value`; a value in quotes may have several lines.
ASSIGNMENT = re.compile(
    r"""^[ \t]*(?:export\s+)?([\w.-]+)[ \t]*=[ \t]*(?:'([^']*)'|"((?:[^"\\]|\\.)*)"|(.*))""",
    re.MULTILINE,
)
#: What a character behind a backslash stands for; any other one for itself.
ESCAPES = {"n": "\n", "r": "\r", "t": "\t", "$": "$$"}
SIZE = re.compile(r"(\d+(?:\.\d+)?)([kmgt]?)i?b?", re.IGNORECASE)


@attrs.frozen
class Value:
    """A value of a Compose file.

    Attributes:
        place: the place of its key, or of itself in a list.
        content: a mapping, a list, or a text; numbers and booleans are text too.
        written: the text in the Rigelfile, with uses of vars where `content` has their values.
    """

    place: Place
    content: dict[str, Value] | list[Value] | str | None = None
    written: str = ""

    @property
    def text(self) -> str:
        """The text, "" if there is none. Raises UserError for a list or mapping."""
        if self.content is None or isinstance(self.content, str):
            return self.content or ""
        raise self.error("expected a single value", "run `docker compose config` to check it")

    def get(self, *keys: str) -> Value:
        """Return the value below a mapping's keys; without it, a value without content."""
        value = self
        for key in keys:
            value = value.entries().get(key, Value(self.place))
        return value

    def entries(self) -> dict[str, Value]:
        """Return the entries of a mapping; none for anything else."""
        return self.content if isinstance(self.content, dict) else {}

    def elements(self) -> list[Value]:
        """Return the values of a list; any other value is a list of one, no value an empty one."""
        if isinstance(self.content, list):
            return self.content
        return [] if self.content is None else [self]

    def pairs(self) -> dict[str, Value]:
        """Return a mapping, which may be written as a list of `NAME=value`."""
        if isinstance(self.content, dict):
            return self.content
        pairs = {}
        for item in self.elements():
            name, equals, text = item.text.partition("=")
            written = item.written.partition("=")[2]
            pairs[name] = Value(item.place, text if equals else None, written)
        return pairs

    def words(self) -> list[Value]:
        """Return the words of a command; a text is split as a shell splits it."""
        if not isinstance(self.content, str):
            return self.elements()
        try:
            texts, written = shlex.split(self.content), shlex.split(self.written)
        except ValueError as error:
            raise self.error(f"the command cannot be split: {error}", "close its quotes") from error
        texts = texts if len(texts) == len(written) else written  # a variable has no value
        return [Value(self.place, *both) for both in zip(texts, written, strict=True)]

    def path(self, text: str | None = None) -> Path:
        """Return a path, by default its own text, relative to the directory of its file."""
        path = self.text if text is None else text
        return Path(os.path.normpath(Path(self.place.file).parent / path))

    def mount(self) -> tuple[str, str, bool]:
        """Return an entry of `volumes`: source, or "", target, and if it is read-only."""
        if self.entries():
            source, target = self.get("source").text, self.get("target").text
            return source, target, self.get("read_only").text == "true"
        source, target, options, *_ = [*self.text.split(":"), "", ""]
        return (source, target, "ro" in options.split(",")) if target else ("", source, False)

    def size(self) -> str:
        """Return an amount of memory as Kubernetes writes it: 512Mi for 512m."""
        match = SIZE.fullmatch(self.text)
        if not match:
            raise self.error(f'"{self.text}" is not an amount of memory', "use 512m or 2g")
        return f"{match[1]}{match[2].upper()}i" if match[2] else match[1]

    def error(self, message: str, hint: str) -> UserError:
        """Return the error about a value that Docker Compose refuses too."""
        return UserError(f"{self.place}: {message}", hint=hint)


class Variables:
    """The variables of a project: filled in, and remembered if they become vars of the Rigelfile.

    Attributes:
        given: the values of the file `.env` beside the Compose file; a directory is relative to it.
        values: the vars that the filled texts use.
        remarks: about variables without a value.
    """

    def __init__(self) -> None:
        self.given = {"HOME": "~", "PWD": "."}
        self.values: dict[str, str] = {}
        self.remarks: list[Remark] = []

    def read(self, node: YamlNode, file: Path) -> Value:
        """Return a value of a file with all its texts filled in."""
        place = Place(str(file), (node.key_span or node.span).line)
        if isinstance(node.value, dict):
            return Value(place, {key: self.read(one, file) for key, one in node.value.items()})
        if isinstance(node.value, list):
            return Value(place, [self.read(one, file) for one in node.value])
        return Value(place) if node.value is None else self.fill(node.raw or "", place)

    def fill(self, text: str, place: Place) -> Value:
        written = REFERENCE.sub(lambda match: self._replace(match, place), text)
        content = USED_VAR.sub(lambda match: self.values.get(match[1], ""), written)
        return Value(place, content, written)

    def _replace(self, match: re.Match[str], place: Place) -> str:
        """Return what stands for a variable in the Rigelfile: its value, or the use of a var."""
        if match["dollar"]:
            return "$"
        name, kind = match["bare"] or match["name"], match["kind"] or ""
        value = self.given.get(name)
        if kind.startswith(":"):
            value = value or None
        if kind.endswith("+"):
            return "" if value is None else self.fill(match["other"], place).written
        if value is None and kind.endswith("?"):
            message = f"set {name} in the environment, or under `vars` of the Rigelfile"
            self.remarks.append(Remark(place, message))
            return use_var(name)
        if value is None and kind.endswith("-"):
            value = self.fill(match["other"], place).text
        if value is None:
            message = f"{name} has no value in .env, so it is empty in the Rigelfile: fill it in"
            self.remarks.append(Remark(place, message))
        if not value or NO_VAR.search(value) or self.values.setdefault(name, value) != value:
            return value or ""
        return use_var(name)


def read_env_file(file: Path, variables: Variables) -> Iterator[tuple[str, Value]]:
    """Yield the variables of a file of lines `NAME=value`, filled in where Docker Compose does."""
    text = read_text(file)
    for match in ASSIGNMENT.finditer(text):
        name, single, double, plain = match.groups()
        if single is not None:
            value = single.replace("$", "$$")
        elif double is not None:
            value = re.sub(r"\\(.)", lambda match: ESCAPES.get(match[1], match[1]), double)
        else:
            value = re.split(r"(?:^|\s)#", plain)[0].rstrip()
        place = Place(str(file), text.count("\n", 0, match.start()) + 1)
        yield name, variables.fill(value, place)
