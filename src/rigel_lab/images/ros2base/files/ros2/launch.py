"""XML launch files: the parts that this project's tests use, and no Python ones.

Known: arg, node (with param and remap), $(var). Anything else is an error, not ignored.
"""

import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

from processes import Process, supervise
from programs import Failure, executable, prefix

EXPRESSION = re.compile(r"\$\([^()]*\)")


def launch(words):
    """Start what a launch file describes and stay until all of it has ended."""
    places = [word for word in words if ":=" not in word]
    if len(places) not in (1, 2):
        raise Failure("usage: ros2 launch [PACKAGE] FILE [ARG:=VALUE ...]")
    given = dict(word.split(":=", 1) for word in words if ":=" in word)
    file = Path(places[0]) if len(places) == 1 else find_file(*places)
    if not file.is_file():
        raise Failure(f"{file}: the file does not exist")
    return supervise(list(Description(file, given).read()))


class Description:
    """One launch file that is being read."""

    def __init__(self, file, given):
        self.file = file
        self.given = given
        self.known = {}

    def read(self):
        """Yield the processes that the file describes."""
        for element in ElementTree.parse(self.file).getroot():
            if element.tag == "arg":
                name = element.get("name")
                if name not in self.given and element.get("default") is None:
                    raise self.fail(f"the argument {name} has no default: add {name}:=VALUE")
                self.known[name] = self.given.get(name, element.get("default"))
            elif element.tag == "node":
                yield self.make_process(element)
            else:
                raise self.fail(f"this ros2 does not support <{element.tag}>")

    def make_process(self, element):
        if unknown := set(element.keys()) - {"pkg", "exec", "name", "args"}:
            raise self.fail(f"this ros2 does not support {min(unknown)}= of <node>")
        program = self.get(element, "exec")
        name = self.get(element, "name", "")
        ros = ["-r", f"__node:={name}"] if name else []
        for child in element:
            if child.tag == "remap":
                ros += ["-r", f"{self.get(child, 'from')}:={self.get(child, 'to')}"]
            elif child.tag != "param":
                raise self.fail(f"this ros2 does not support <{child.tag}>")
            elif file := self.get(child, "from", ""):
                ros += ["--params-file", file]
            else:
                ros += ["-p", f"{self.get(child, 'name')}:={self.get(child, 'value')}"]
        command = [executable(self.get(element, "pkg"), program)]
        command += shlex.split(self.get(element, "args", ""))
        command += ["--ros-args", *ros] if ros else []
        return Process(name or program, command)

    def get(self, element, name, default=None):
        """Return an attribute with its $(var ...) filled in."""
        text = element.get(name, default)
        if text is None:
            raise self.fail(f"<{element.tag}> has no {name}=")
        return EXPRESSION.sub(self.fill, text)

    def fill(self, found):
        function, _, name = found[0][2:-1].partition(" ")
        if function != "var" or name not in self.known:
            raise self.fail(f"{found[0]} is not supported here")
        return self.known[name]

    def fail(self, message):
        return Failure(f"{self.file}: {message}")


def find_file(package, name):
    """Return a launch file of a package, by its name."""
    found = sorted((prefix(package) / "share" / package).rglob(name))
    if len(found) != 1:
        count = "no file" if not found else f"{len(found)} files"
        raise Failure(f"package '{package}' has {count} named '{name}' in its share directory")
    return found[0]
