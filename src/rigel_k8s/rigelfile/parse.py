"""YAML to Nodes: every value keeps its place and its text; ambiguous YAML is refused.

It reads YAML 1.1, as Rigel and kubectl do.
"""

from __future__ import annotations

import re
from typing import Any

import attrs
import yaml

from rigel_k8s.rigelfile.findings import Finding
from rigel_k8s.rigelfile.limits import DEEPEST, LONGEST_NUMBER, MOST_VALUES
from rigel_k8s.rigelfile.source import Source, Span, YamlNode

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_CONSTRUCT = yaml.constructor.SafeConstructor()
_TAG = "tag:yaml.org,2002:"
_TEXT_TAGS = frozenset({f"{_TAG}str", f"{_TAG}timestamp", f"{_TAG}value"})
#: Rigelfiles of Rigel 0.3 have tuples, for options that are lists here.
_COLLECTION_TAGS = frozenset({f"{_TAG}map", f"{_TAG}seq", f"{_TAG}python/tuple"})
_NUMBER_TAGS = frozenset({f"{_TAG}int", f"{_TAG}float"})
_START = Span(1, 1, 1, 2)
TOO_MANY = f"the file has more than {MOST_VALUES} values, including those from aliases"
_BARE_TEMPLATE = re.compile(r"(?:^|[:,\-\[]\s)\s*(\{\{.*?\}\}[^\s,\]}]*)")


def parse(source: Source) -> tuple[YamlNode | None, list[Finding]]:
    """Return the root of a YAML text and what is wrong with it; None where it cannot be read."""
    if excess := find_excess(source.text):
        return None, [excess]
    try:
        root = yaml.compose(source.text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        return None, [_syntax(error, source)]
    except yaml.YAMLError as error:
        return None, [_find_unreadable(error, source)]
    if root is None:
        return None, [Finding(_START, "the file is empty: `rigel init` writes a first one", "yaml")]
    reader = _Reader()
    node = reader.node(root)
    return (None if reader.is_full else node), reader.findings


def find_excess(text: str) -> Finding | None:
    """Return what would exhaust the C parser's stack or the memory, before parsing the whole text.

    Keys and values are counted here, so a file may have up to twice as many as it may have values.
    """
    depth = values = 0
    try:
        for event in yaml.parse(text, Loader=_Loader):
            values += isinstance(event, yaml.NodeEvent)
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
            if depth > DEEPEST or values > 2 * MOST_VALUES:
                too_deep = f"values are nested more than {DEEPEST} deep"
                message = too_deep if depth > DEEPEST else TOO_MANY
                start: Any = event.start_mark
                end: Any = event.end_mark or start
                return Finding(_span(start, end), message, "yaml")
    except yaml.YAMLError:  # reported when it is parsed
        pass
    return None


def _syntax(error: yaml.MarkedYAMLError, source: Source) -> Finding:
    """Return the error of the YAML parser, at its place."""
    mark = error.problem_mark or error.context_mark
    line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
    span = Span(line, column, line, column + 1)
    lines = [*source.lines, ""]
    text = lines[min(line, len(lines)) - 1]
    bare = _BARE_TEMPLATE.search(text)
    if bare:
        start, end = bare.start(1) + 1, bare.end(1) + 1
        return Finding(Span(line, start, line, end), _explain_quotes(bare[1]), "yaml")
    if text[column - 1 : column] == "\t" or text.startswith("\t"):
        return Finding(span, "a tab: YAML indents with spaces only", "yaml")
    if error.problem == "but found another document":
        return Finding(span, "a second document begins: a Rigelfile has one", "yaml")
    context = f", {error.context}" if error.context else ""
    if context and error.context_mark:
        context += f" that begins at {error.context_mark.line + 1}:{error.context_mark.column + 1}"
    return Finding(span, f"this is not YAML: {error.problem}{context}", "yaml")


def _find_unreadable(error: yaml.YAMLError, source: Source) -> Finding:
    """Return the character that YAML does not allow, at its place."""
    bad = yaml.reader.Reader.NON_PRINTABLE.search(source.text)
    if not bad:
        return Finding(_START, f"this is not YAML: {error}", "yaml")
    line = source.text.count("\n", 0, bad.start()) + 1
    column = bad.start() - source.text.rfind("\n", 0, bad.start())
    message = f"the character U+{ord(bad[0]):04X} is not allowed here"
    return Finding(Span(line, column, line, column + 1), message, "yaml")


def _explain_quotes(template: str) -> str:
    return f'a value that begins with {{{{ must be quoted: "{template}"'


def _span(start: yaml.Mark, end: yaml.Mark) -> Span:
    return Span(start.line + 1, start.column + 1, end.line + 1, end.column + 1)


class _Reader:
    """Turns YAML's nodes into ours and collects findings on the way."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []
        self.is_full = False  # the file has more values than are read
        self._open: set[int] = set()
        self._done: dict[int, tuple[YamlNode, int]] = {}
        self._count = 0

    def node(self, item: yaml.Node) -> YamlNode:
        """Return the Node of a YAML node; one that is used twice (an alias) is converted once."""
        if id(item) in self._done:
            node, size = self._done[id(item)]
            self._count += size
            return node if self._count <= MOST_VALUES else self._refuse_more(item)
        if id(item) in self._open:
            return self._refuse(item, "an alias of a value that contains it")
        before = self._count
        self._count += 1
        if self._count > MOST_VALUES:
            return self._refuse_more(item)
        self._open.add(id(item))
        result = self._make(item)
        self._open.discard(id(item))
        self._done[id(item)] = result, self._count - before
        return result

    def _refuse(self, item: yaml.Node, message: str, kind: str = "yaml") -> YamlNode:
        span = _span(item.start_mark, item.end_mark)
        self.findings.append(Finding(span, message, kind))
        return YamlNode(None, span, hole=True)

    def _refuse_more(self, item: yaml.Node) -> YamlNode:
        if self.is_full:  # reported once
            return YamlNode(None, _span(item.start_mark, item.end_mark), hole=True)
        self.is_full = True
        return self._refuse(item, TOO_MANY)

    def _make(self, item: yaml.Node) -> YamlNode:
        span = _span(item.start_mark, item.end_mark)
        if isinstance(item, yaml.CollectionNode) and item.tag not in _COLLECTION_TAGS:
            return self._refuse(item, f"the tag {item.tag} is not supported: remove it")
        if isinstance(item, yaml.MappingNode):
            bare = _explain_bare_template(item)
            return self._refuse(item, bare) if bare else YamlNode(self._mapping(item), span)
        if isinstance(item, yaml.SequenceNode):
            return YamlNode([self.node(child) for child in item.value], span)
        return YamlNode(self._scalar(item), span, raw=str(item.value))

    def _scalar(self, item: Any) -> Any:
        try:
            if item.tag == f"{_TAG}null":
                return None
            if item.tag == f"{_TAG}bool":
                return _CONSTRUCT.construct_yaml_bool(item)
            if item.tag in _NUMBER_TAGS and len(item.value) > LONGEST_NUMBER:
                self._refuse(item, f"a number of more than {LONGEST_NUMBER} characters")
                return str(item.value)
            if item.tag == f"{_TAG}int":
                return _CONSTRUCT.construct_yaml_int(item)
            if item.tag == f"{_TAG}float":
                return _CONSTRUCT.construct_yaml_float(item)
        except (
            ValueError,
            LookupError,
            OverflowError,
        ):  # an explicit tag on a text that does not fit it
            self._refuse(item, f'"{item.value}" does not fit its tag')
        else:
            if item.tag not in _TEXT_TAGS:
                self._refuse(item, f"the tag {item.tag} is not supported: remove it")
        return str(item.value)

    def _mapping(self, item: yaml.MappingNode) -> dict[str, YamlNode]:
        result: dict[str, YamlNode] = {}
        inherited: dict[str, YamlNode] = {}
        for key, value in item.value:
            if key.tag == f"{_TAG}merge":
                inherited = inherited | self._merge(value)
            elif not isinstance(key, yaml.ScalarNode):
                self._refuse(key, "a key must be text, not a list or mapping")
            else:
                self._add(result, key, value)
        return {**inherited, **result}

    def _add(self, result: dict[str, YamlNode], key: yaml.ScalarNode, value: yaml.Node) -> None:
        name = str(key.value)
        node = attrs.evolve(self.node(value), key_span=_span(key.start_mark, key.end_mark))
        if name not in result:
            result[name] = node
            return
        first = result[name].key_span or _START
        message = f'the key "{name}" is already at {first.line}:{first.column}: remove one'
        self._refuse(key, message, "duplicate-key")

    def _merge(self, value: yaml.Node) -> dict[str, YamlNode]:
        """Return the keys that `<<` merges in; earlier ones win."""
        merged: dict[str, YamlNode] = {}
        for part in reversed(value.value if isinstance(value, yaml.SequenceNode) else [value]):
            if isinstance(part, yaml.MappingNode):
                merged |= self.node(part).value or {}
            else:
                self._refuse(part, "<< needs an alias of a mapping, or a list of them")
        return merged


def _explain_bare_template(item: yaml.MappingNode) -> str | None:
    """Return the message about `{{ x }}` without quotes, which YAML reads as two mappings."""
    if len(item.value) != 1 or not item.flow_style:
        return None
    key, value = item.value[0]
    if not isinstance(key, yaml.MappingNode) or value.value or len(key.value) != 1:
        return None
    return _explain_quotes(f"{{{{ {key.value[0][0].value} }}}}")
