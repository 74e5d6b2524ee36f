"""XML launch files: the parts that most of them use, and no Python ones.

Known: arg, let, set_env, group (with push_ros_namespace), include, node (with param, remap, env),
executable; `if` and `unless`; $(var), $(env), $(find-pkg-share), $(dirname). Anything else is an
error, not ignored.
"""

import os
import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

import yaml
from failure import Failure
from processes import Process, supervise
from programs import executable, prefix

_FUNCTION = re.compile(r"\$\(([a-z-]+)((?:\s[^()]*)?)\)")


def launch(words):
    """Start what a launch file describes and stay until all of it has ended."""
    places = [word for word in words if ":=" not in word and not word.startswith("-")]
    if len(places) not in (1, 2):
        raise Failure("usage: ros2 launch [PACKAGE] FILE [ARG:=VALUE ...]")
    given = dict(word.split(":=", 1) for word in words if ":=" in word)
    return supervise(Description(given).read(_file(*places)))


class Description:
    """One launch file that is being read, with its surroundings."""

    def __init__(self, given, namespace="", env=None):
        self.given = given
        self.known = {}
        self.namespace = namespace
        self.env = dict(os.environ if env is None else env)

    def read(self, file):
        """Return the processes that a file describes."""
        if file.suffix != ".xml":
            raise Failure(f"{file}: this ros2 reads XML launch files only (PyPI has no `launch`)")
        self.file = file
        return self._children(ElementTree.parse(file).getroot())

    def _children(self, element):
        found = []
        for child in element:
            if self._wanted(child):
                reader = getattr(self, "_" + child.tag.replace("-", "_"), None)
                if reader is None or child.tag.startswith("_"):
                    raise Failure(f"{self.file}: this ros2 does not support <{child.tag}>")
                found += reader(child) or []
        return found

    def _arg(self, element):
        name = self._get(element, "name")
        default = self._get(element, "default", None)
        if name not in self.given and default is None:
            raise Failure(f"{self.file}: the argument {name} has no default: add {name}:=VALUE")
        self.known[name] = self.given.get(name, default)

    def _let(self, element):
        self.known[self._get(element, "name")] = self._get(element, "value")

    def _set_env(self, element):
        self.env[self._get(element, "name")] = self._get(element, "value")

    def _push_ros_namespace(self, element):
        self.namespace = self._joined(self._get(element, "namespace"))

    def _group(self, element):
        before = dict(self.known), self.namespace, dict(self.env)
        found = self._children(element)
        self.known, self.namespace, self.env = before
        return found

    def _include(self, element):
        given = {self._get(a, "name"): self._get(a, "value") for a in element.findall("arg")}
        inner = Description({**self.known, **given}, self.namespace, self.env)
        return inner.read(Path(self._get(element, "file")))

    def _executable(self, element):
        command = shlex.split(self._get(element, "cmd"))
        return [Process(self._get(element, "name", Path(command[0]).name), command, self.env)]

    def _node(self, element):
        program = self._get(element, "exec")
        command = [executable(self._get(element, "pkg"), program)]
        command += shlex.split(self._get(element, "args", ""))
        ros = []
        if name := self._get(element, "name", ""):
            ros += ["-r", f"__node:={name}"]
        if namespace := self._joined(self._get(element, "namespace", "")):
            ros += ["-r", f"__ns:={namespace}"]
        for remap in element.findall("remap"):
            ros += ["-r", f"{self._get(remap, 'from')}:={self._get(remap, 'to')}"]
        for param in element.findall("param"):
            ros += self._param(param)
        env = {self._get(e, "name"): self._get(e, "value") for e in element.findall("env")}
        command += ["--ros-args", *ros] if ros else []
        return [Process(name or program, command, {**self.env, **env})]

    def _param(self, element):
        if file := self._get(element, "from", ""):
            return ["--params-file", file]
        value = self._get(element, "value")
        return ["-p", f"{self._get(element, 'name')}:={value}"]

    def _joined(self, namespace):
        parts = [namespace] if namespace.startswith("/") else [self.namespace, namespace]
        joined = "/".join(part.strip("/") for part in parts if part.strip("/"))
        return f"/{joined}" if joined else ""

    def _wanted(self, element):
        wanted = yaml.safe_load(self._get(element, "if", "true"))
        unwanted = yaml.safe_load(self._get(element, "unless", "false"))
        return bool(wanted) and not unwanted

    def _get(self, element, name, default=...):
        """Return an attribute with its $(...) filled in."""
        text = element.get(name, default)
        if text is ...:
            raise Failure(f"{self.file}: <{element.tag}> has no {name}=")
        return _FUNCTION.sub(self._filled, text) if text else text

    def _filled(self, found):
        name, words = found[1], found[2].split(None, 1)
        if name == "dirname":
            return str(self.file.resolve().parent)
        if name == "var" and words and words[0] in self.known:
            return str(self.known[words[0]])
        if name == "env" and words and (words[0] in self.env or len(words) == 2):
            return self.env.get(words[0], words[-1])
        if name == "find-pkg-share" and words:
            return str(prefix(words[0]) / "share" / words[0])
        raise Failure(f"{self.file}: {found[0]} is not supported here")


def _file(*words):
    """Return a launch file by its path, or by its package and name."""
    if len(words) == 1:
        if not Path(words[0]).is_file():
            raise Failure(f"{words[0]}: the file does not exist")
        return Path(words[0])
    package, name = words
    found = sorted((prefix(package) / "share" / package).rglob(name))
    if len(found) != 1:
        count = "no file" if not found else f"{len(found)} files"
        raise Failure(f"package '{package}' has {count} named '{name}' in its share directory")
    return found[0]
