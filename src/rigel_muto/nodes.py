"""One node of a stack as options of a node of ours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import attrs

from rigel_k8s.option_text import text_of
from rigel_k8s.problems import Path
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.rigelfile.source import YamlNode, kind_of, node_of
from rigel_muto.arguments import Arguments, Completion
from rigel_muto.parameters import Parameters
from rigel_muto.remarks import Remark, Unreadable, describe_unknown, error, loss, note
from rigel_muto.stack import is_empty, text_at

#: Keys of a node that become options, and those that only Muto needs.
CARRIED = (
    *("name", "namespace", "pkg", "exec", "args", "param", "remap", "env", "lifecycle"),
    *("if", "unless"),
)
UNNEEDED = ("output", "action", "respawn", "respawn_delay")
#: Keys that have no counterpart, with why, or what to do.
LOST: Mapping[str, str] = {
    "launch-prefix": "set the node's `package` and `executable` to null in the Rigelfile, and"
    " `args` to the whole line, as in `nice rosrun PACKAGE EXECUTABLE`",
    "ros_args": "add its words to `args`",
    "required": "Kubernetes starts this node again, and stops no other one",
    "cwd": "set WORKDIR in the image",
    "plugin": "only a container loads components",
}
_CONDITIONS = {"true": True, "1": True, "false": False, "0": False}


@attrs.frozen
class Translated:
    """The result for a node; `options` is None if it is left out."""

    key: str
    options: YamlNode | None
    remarks: tuple[Remark, ...]


def translate_node(entry: YamlNode, arguments: Arguments, above: Path = ()) -> Translated:
    """Return a node of a stack as an entry of `nodes`.

    Args:
        above: the path in `nodes` of a mapping that contains it instead.
    """
    work = _Node(entry, arguments, above)
    try:
        options = work.translate()
    except Unreadable as fault:
        return Translated(work.key, None, (*work.remarks, fault.remark))
    return Translated(work.key, options, tuple(work.remarks))


class _Node:
    """One node during its translation."""

    def __init__(self, entry: YamlNode, arguments: Arguments, above: Path) -> None:
        self.remarks: list[Remark] = []
        self._above = above
        self.key = text_at(entry.value, "name")
        self._entry = entry
        self._content = {k: v for k, v in entry.value.items() if not is_empty(v)}
        self._completion = Completion(arguments, self._lose_with_advice)
        self._options: dict[str, YamlNode] = {}

    def translate(self) -> YamlNode | None:
        """Return the options; None if a condition leaves the node out."""
        name = self._need("name")
        self.key = self._make_key(name)
        if self._is_left_out():
            return None
        self._put("package", self._need("pkg"))
        self._put("executable", self._need("exec"))
        self._carry("args", "args")
        self._carry_parameters()
        self._carry_remappings()
        self._carry_environment()
        self._carry_lifecycle()
        if self._completion.substitutes:
            self._put("substitution_args", node_of(True, self._entry))
        self._remark_on_rest()
        return attrs.evolve(self._entry, value=self._options, raw=None, key_span=name.span)

    def _make_key(self, name: YamlNode) -> str:
        """Return the node's full ROS name without the slash at its beginning."""
        namespace = self._content.get("namespace")
        above = "" if namespace is None else text_of(self._know("namespace", namespace).value)
        return "/".join(filter(None, (above.strip("/"), text_of(name.value).strip("/"))))

    def _need(self, key: str) -> YamlNode:
        """Return a text that a node must have, and that only the stack can give."""
        value = self._content.get(key)
        if value is None:
            message = f'the key "{key}" is missing'
            raise Unreadable(error(self._entry, message, "missing-key"))
        return self._know(key, value)

    def _know(self, key: str, value: YamlNode) -> YamlNode:
        """Return a scalar without expressions. Raises Unreadable if a container is needed."""
        resolved = self._completion.know(key, value)
        if isinstance(resolved.value, dict | list):
            message = f'"{key}" must be text, got {kind_of(resolved.value)}'
            raise Unreadable(error(resolved, message, "wrong-type"))
        return resolved

    def _is_left_out(self) -> bool:
        for key, wanted in (("if", True), ("unless", False)):
            condition = self._content.get(key)
            if condition is None:
                continue
            truth = _CONDITIONS.get(text_of(self._know(key, condition).value).lower())
            if truth is None:
                message = f'"{key}" must be true, false, 1 or 0'
                raise Unreadable(error(condition, message, "wrong-type"))
            if truth is not wanted:
                message = f'"{self.key}" is left out, as roslaunch does; Muto would start it'
                self.remarks.append(note(condition, message, "left-out"))
                return True
        return False

    # Options

    def _put(self, option: str, value: YamlNode) -> None:
        self._options[option] = attrs.evolve(value, key_span=value.key_span or value.span)

    def _carry(self, key: str, option: str) -> None:
        value = self._content.get(key)
        if value is None:
            return
        known = self._completion.complete(f"`{key}`", (option,), value)
        if known is not None:
            self._put(option, known)

    def _lose_with_advice(self, at: YamlNode, message: str, option: Path, kind: str) -> None:
        """Remark on what is lost, and on the option that would replace it, if there is one."""
        path = ".".join(map(str, (*self._above, self.key, *option)))
        advice = f"; set nodes.{path} in the Rigelfile" if option else ""
        self._lose(at, message + advice, option, kind)

    def _lose(
        self, at: YamlNode, message: str, option: Path = (), kind: str = "not-carried"
    ) -> None:
        node, *below = (*self._above, self.key)
        path = (*below, *option) if option else ()
        self.remarks.append(loss(at, message, kind=kind, node=str(node), option=path))

    def _list(self, key: str) -> list[YamlNode]:
        section = self._content.get(key)
        if section is None:
            return []
        entries = section.value if isinstance(section.value, list) else [section]
        for entry in entries:
            if not isinstance(entry.value, dict):
                message = f'"{key}" must be a list of mappings, got {kind_of(entry.value)}'
                raise Unreadable(error(entry, message, "wrong-type"))
        return list(entries)

    def _text(self, entry: YamlNode, key: str) -> str:
        value = entry.value.get(key)
        if value is None or is_empty(value):
            raise Unreadable(error(entry, f'the key "{key}" is missing', "missing-key"))
        return text_of(self._know(key, value).value)

    def _gather(self, option: str, section: str, found: dict[str, YamlNode]) -> None:
        if found:
            self._put(option, attrs.evolve(self._content[section], value=found, raw=None))

    def _carry_parameters(self) -> None:
        parameters = Parameters(self._completion)
        for entry in self._list("param"):
            parameters.add(entry)
        section = self._content.get("param", self._entry)
        self._options.update(parameters.options(section))

    def _carry_remappings(self) -> None:
        found: dict[str, YamlNode] = {}
        for entry in self._list("remap"):
            name = self._text(entry, "from")
            target = node_of(self._text(entry, "to"), entry.value["to"])
            found[name] = attrs.evolve(target, key_span=entry.value["from"].span)
        self._gather("remappings", "remap", found)

    def _carry_environment(self) -> None:
        found: dict[str, YamlNode] = {}
        for entry in self._list("env"):
            name = self._text(entry, "name")
            value = entry.value.get("value", attrs.evolve(entry, value="", raw=""))
            known = self._completion.complete(f'the variable "{name}"', ("env", name), value)
            if known is not None:
                found[name] = attrs.evolve(known, key_span=entry.value["name"].span)
        self._gather("env", "env", found)

    def _carry_lifecycle(self) -> None:
        section = self._content.get("lifecycle")
        if section is not None:
            transitions = read_lifecycle(section)
            if transitions.value:
                self._put("lifecycle", transitions)
            self.remarks += list_losses(section, str((*self._above, self.key)[0]))

    def _remark_on_rest(self) -> None:
        """Remark on the node's keys that are not options."""
        for key, value in self._content.items():
            if key in LOST:
                message = f"`{key}` is not carried over: {LOST[key]}"
                self._lose(value, message, ("package",) if key == "launch-prefix" else ())
            elif key not in CARRIED and key not in UNNEEDED:
                self._lose(value, describe_unknown(key, "a node", (*CARRIED, *LOST)))


TIMES = ("start", "stop")
TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")


def read_lifecycle(section: YamlNode) -> YamlNode:
    """Return the option `lifecycle`. Raises Unreadable if it has something else in a list."""
    if not isinstance(section.value, dict):
        message = f'"lifecycle" must be a mapping, got {kind_of(section.value)}'
        raise Unreadable(error(section, message, "wrong-type"))
    found = {
        time: attrs.evolve(section.value[time], value=list(list_transitions(section.value[time])))
        for time in TIMES
        if time in section.value and not is_empty(section.value[time])
    }
    return attrs.evolve(section, value=found)


def list_transitions(value: YamlNode) -> Iterator[YamlNode]:
    """Yield the transitions of a list; a text is a list of one."""
    for entry in value.value if isinstance(value.value, list) else [value]:
        if isinstance(entry.value, dict | list) or text_of(entry.value) not in TRANSITIONS:
            what = f'"{entry.value}"' if isinstance(entry.value, str) else kind_of(entry.value)
            close = suggest(str(entry.value), TRANSITIONS)
            message = f"{what} is not a transition of a lifecycle node{close}"
            raise Unreadable(error(entry, message, "unknown-transition"))
        yield entry


def list_losses(section: YamlNode, node: str) -> Iterator[Remark]:
    """Yield the parts of a node's `lifecycle` that have no counterpart."""
    for key, value in section.value.items():
        if key not in TIMES and not is_empty(value):
            yield loss(value, describe_unknown(key, "a lifecycle", TIMES), node=node)
