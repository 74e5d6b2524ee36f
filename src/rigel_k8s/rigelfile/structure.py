"""Nodes to option classes of other packages, strictly, with all problems at once.

It handles attrs classes and plain types, but is independent of single options. Problems have paths;
findings.py finds their places in the text. A value that waits for `{{ data.x }}`, or is wrong, does
not stop the check of the rest: `draft` has the field's default in its place.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import attrs

from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem
from rigel_k8s.rigelfile.expansion import list_added_fields
from rigel_k8s.rigelfile.fields import (
    Field,
    describe_type,
    fields_by_key,
    fields_of,
    is_list,
    is_mapping,
    members,
    type_arguments,
    unwrap,
)
from rigel_k8s.rigelfile.findings import find_nearest, suggest
from rigel_k8s.rigelfile.limits import MOST_SUGGESTIONS
from rigel_k8s.rigelfile.scalars import (
    Mismatch,
    choose_by_keys,
    find_ambiguity,
    find_candidates,
    find_trap,
    is_a,
    is_yes_or_no,
    keep_text,
    mismatch,
    scalar,
)
from rigel_k8s.rigelfile.source import Span, YamlNode, node_of, strip_places

T = TypeVar("T")
_UNKNOWN: Any = object()


@attrs.define
class Doubts:
    """Paths whose value is not final, so that a check there may be wrong.

    Attributes:
        texts: texts with a hole, as written.
        missing: a default replaces a hole or a misspelt key: its siblings are in doubt too.
        wrong: a default replaces a wrong value, which is already reported.
    """

    texts: list[Path] = attrs.field(factory=list)
    missing: list[Path] = attrs.field(factory=list)
    wrong: list[Path] = attrs.field(factory=list)

    def may_explain(self, path: Path) -> bool:
        """Return whether a problem at this path may be caused by one of them."""
        return (
            any(_begins(path, doubt) for doubt in (*self.texts, *self.wrong, *self.missing))
            or any(_begins(doubt, path) for doubt in (*self.wrong, *self.missing))
            or any(doubt[:-1] == path[:-1] for doubt in self.missing)
        )

    def include(self, other: Doubts) -> None:
        """Add the doubts of another one."""
        self.texts += other.texts
        self.missing += other.missing
        self.wrong += other.wrong


def _begins(path: Path, start: Path) -> bool:
    return path[: len(start)] == start


def _find_owner(word: str, known: Mapping[str, Field]) -> str | None:
    """Return the key whose mapping has objects with an option of exactly this name."""
    for key, outer in known.items():
        kind = unwrap(outer.type)
        inner = type_arguments(kind)[1] if is_mapping(kind) else None
        own = fields_of(inner) if isinstance(inner, type) and attrs.has(inner) else ()
        if any(word in field.keys for field in own):
            return key
    return None


@attrs.frozen
class Structured:
    """The result for a Node.

    Attributes:
        draft: the value, as far as it is known; None if not enough of it is.
        problems: what is wrong, with paths from the Node.
        doubts: where the draft is not final.
    """

    draft: Any
    problems: tuple[Problem, ...]
    doubts: Doubts

    @property
    def value(self) -> Any:
        """The value; None if something is wrong, or not enough is known."""
        return None if self.problems else self.draft

    @property
    def complete(self) -> bool:
        """Whether no hole is left."""
        return not (self.doubts.texts or self.doubts.missing)


def structure(node: YamlNode, kind: Any) -> Structured:
    """Return the value of a type that a Node describes, or all that is wrong with it."""
    whole = unwrap(kind)
    is_class = isinstance(whole, type) and attrs.has(whole)
    work = _Structurer(fields_by_key(whole) if is_class else {})
    value = work.value(node, kind, ())
    draft = None if value is _UNKNOWN else value
    return Structured(draft, tuple(work.problems), work.doubts)


class InvalidOptions(Exception):
    """Plain data that is not a value of an option class.

    Attributes:
        problems: at least one, with paths from the data's root.
    """

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("; ".join(map(str, problems)))
        self.problems = tuple(problems)


def structure_plain(
    data: Mapping[str, Any], kind: type[T], check: Callable[[T], Iterable[Problem]]
) -> T:
    """Return plain data, which is not from a file, as a value of an option class.

    Args:
        check: returns what is wrong with such a value; warnings are ignored.

    Raises:
        InvalidOptions: it is not such a value.
    """
    found = structure(node_of(dict(data), YamlNode({}, Span(1, 1, 1, 1))), kind)
    problems = list(found.problems)
    if found.draft is not None and not problems:
        problems = [problem for problem in check(found.draft) if problem.severity == "error"]
    if found.draft is None or problems:
        raise InvalidOptions(problems)
    value: T = found.draft
    return value


class _Structurer:
    """One walk over a Node; `_UNKNOWN` is a value that is wrong (reported) or waits for data."""

    def __init__(self, outermost: Mapping[str, Field]) -> None:
        self._outermost = outermost
        self.problems: list[Problem] = []
        self.doubts = Doubts()

    def value(self, node: YamlNode, kind: Any, path: Path) -> Any:
        kind = unwrap(kind)
        if kind is YamlNode:
            return node
        if node.hole:
            return self._fill_hole(node, kind, path)
        if kind is Any or kind is object:
            self._note_holes(node, path, traps=bool(path))
            return strip_places(node)
        kinds = members(kind)
        if len(kinds) > 1:
            return self._union(node, kind, kinds, path)
        if isinstance(kind, type) and attrs.has(kind):
            return self._object(node, kind, path)
        if is_mapping(kind):
            return self._mapping(node, kind, path)
        if is_list(kind):
            return self._list(node, kind, path)
        return self._scalar(node, kind, path)

    def _report(self, path: Path, message: str, kind: str, *, at_key: bool = False) -> Any:
        self.problems.append(Problem(path, message, kind, at_key=at_key))
        self.doubts.wrong.append(path)
        return _UNKNOWN

    def _report_mismatch(self, found: Mismatch, path: Path) -> Any:
        return self._report(path, found.message, found.kind)

    # Holes

    def _fill_hole(self, node: YamlNode, kind: Any, path: Path) -> Any:
        for member in members(kind):
            if isinstance(member, type) and issubclass(member, str):
                self.doubts.texts.append(path)
                return str.__new__(member, node.value)
        self.doubts.missing.append(path)
        return node.value if kind is Any else _UNKNOWN

    def _note_holes(self, node: YamlNode, path: Path, *, traps: bool) -> None:
        if node.hole:
            self.doubts.texts.append(path)
        elif traps and (trap := find_trap(node)):
            self._report(path, trap, "wrong-type")
        for step, child in node.entries():
            self._note_holes(child, (*path, step), traps=traps)

    # Containers

    def _object(self, node: YamlNode, cls: Any, path: Path) -> Any:
        if not isinstance(node.value, dict):
            return self._report_mismatch(mismatch(node, cls), path)
        fields = fields_of(cls)
        known = fields_by_key(cls)
        guessed = set(self._report_unknown_keys(node, cls, path))
        values: dict[str, Any] = {}
        unknown = False
        for key, child in node.value.items():
            field = known.get(key)
            if field is None:
                continue
            if field.name in values:
                message = f'"{key}" and "{field.key}" mean the same: remove one'
                self._report((*path, key), message, "duplicate-key", at_key=True)
            value = self.value(child, field.type, (*path, key))
            if value is not _UNKNOWN:
                values[field.name] = value
            unknown = unknown or (value is _UNKNOWN and field.required)
        absent = [f for f in fields if f.required and not node.value.keys() & set(f.keys)]
        for field in absent:
            if not guessed & {*field.keys, None}:
                self._report_missing(field, path)
        return _UNKNOWN if unknown or absent else self._built(cls, values, path)

    def _report_unknown_keys(self, node: YamlNode, cls: Any, path: Path) -> Iterator[str | None]:
        """Report unknown keys; yield the similar key, None for a key that waits for data."""
        for key in [key for key in node.value if key not in fields_by_key(cls)]:
            self.doubts.missing.append((*path, key))
            if has_template(key):
                yield None
                continue
            if replacement := find_replacement((*path, key)):
                message, near, kind = f'the option "{key}" ended: {replacement}', None, "ended"
            else:
                meant, near = self._find_meant(key, node, cls, path)
                message, kind = f'unknown key "{key}"{meant}', "unknown-key"
            self.problems.append(Problem((*path, key), message, kind, at_key=True))
            if near:
                yield near

    def _find_meant(self, key: str, node: YamlNode, cls: Any, path: Path) -> tuple[str, str | None]:
        """Return the words on what an unknown key may mean, and the similar key if any."""
        if len(self.problems) >= MOST_SUGGESTIONS:  # the search for a similar key takes long
            return "", None
        known = fields_by_key(cls)
        if instead := getattr(cls, "foreign", {}).get(key):
            return f": {instead}", next((name for name in known if f"`{name}`" in instead), None)
        if owner := _find_owner(key, known):
            return f', it is an option of each entry of "{owner}"', None
        absent = [name for name in known if name not in node.value]
        absent += [field.key for field in list_added_fields(cls)]
        near = find_nearest(key, absent)
        if path and near is None and key in self._outermost:
            return ", it is an option of the job", None
        return suggest(key, absent or known), near

    def _report_missing(self, field: Field, path: Path) -> None:
        what = (
            f"{describe_type(field.type)}: {field.doc}" if field.doc else describe_type(field.type)
        )
        message = f'the key "{field.key}" is missing ({what})'
        self._report(path, message, "missing-key", at_key=True)

    def _built(self, cls: Any, values: dict[str, Any], path: Path) -> Any:
        try:
            return cls(**values)
        except (ValueError, TypeError) as error:  # a validator of the class refused it
            return self._report(path, str(error), "bad-value")

    def _mapping(self, node: YamlNode, kind: Any, path: Path) -> Any:
        if not isinstance(node.value, dict):
            return self._report_mismatch(mismatch(node, kind), path)
        key_kind, value_kind = type_arguments(kind)
        result = {}
        for key, child in node.value.items():
            place = (*path, key)
            new_key = self._key(key, child, unwrap(key_kind), place)
            nested = getattr(key_kind, "nested", "") if isinstance(child.value, dict) else ""
            if nested:
                value = self._report_mismatch(mismatch(child, value_kind, nested % key), place)
            else:
                value = self.value(child, value_kind, place)
            if new_key is not _UNKNOWN and value is not _UNKNOWN:
                result[new_key] = value
        return result

    def _key(self, key: str, child: YamlNode, kind: Any, path: Path) -> Any:
        if has_template(key):
            self.doubts.missing.append(path)
            return key
        if kind is Any or kind is str:
            return key
        node = YamlNode(key, child.key_span or child.span, raw=key, untyped=True)
        try:
            return scalar(node, kind)
        except Mismatch as found:
            return self._report(path, found.message, found.kind, at_key=True)

    def _list(self, node: YamlNode, kind: Any, path: Path) -> Any:
        if not isinstance(node.value, list):
            one = not isinstance(node.value, dict) and node.value is not None
            hint = f": write [{node.raw}]" if one and node.raw else ""
            return self._report_mismatch(mismatch(node, kind, hint), path)
        inner = type_arguments(kind)[0]
        values = [self.value(c, inner, (*path, i)) for i, c in enumerate(node.value)]
        known = [value for value in values if value is not _UNKNOWN]
        if len(known) < len(values):  # the places of the others have moved
            self.doubts.wrong.append(path)
        origin = typing.get_origin(kind) or kind
        make: Callable[[Iterable[Any]], Any] = origin if origin in (tuple, set, frozenset) else list
        return make(known)

    # Scalars and unions

    def _scalar(self, node: YamlNode, kind: Any, path: Path) -> Any:
        try:
            return scalar(node, kind)
        except Mismatch as found:
            if replacement := find_replacement((*path, str(node.value))):
                message = f'the value "{node.value}" ended: {replacement}'
                return self._report(path, message, "ended")
            return self._report_mismatch(found, path)

    def _union(self, node: YamlNode, kind: Any, kinds: tuple[Any, ...], path: Path) -> Any:
        if node.value is None and type(None) in kinds:
            return None
        if is_yes_or_no(node) and any(is_a(k, str) for k in kinds):
            return self._scalar(node, str, path)
        given: Any = type(node.value)
        candidates = find_candidates(kinds, given)
        if not candidates:
            return self._report_mismatch(find_ambiguity(node, kinds) or mismatch(node, kind), path)
        if isinstance(node.value, dict):
            return self.value(node, choose_by_keys(node, candidates), path)
        if len(candidates) == 1 and not isinstance(node.value, list):
            return self.value(node, candidates[0], path)
        refused = []
        for candidate in candidates:
            trial = _Structurer(self._outermost)
            value = trial.value(node, candidate, path)
            if not trial.problems:
                self.doubts.include(trial.doubts)
                keeps_text = str in kinds and candidate in (int, float)
                return keep_text(value, node.raw) if keeps_text else value
            refused.append(trial)
        return self._report_no_member(node, kind, refused, path)

    def _report_no_member(
        self, node: YamlNode, kind: Any, trials: list[_Structurer], path: Path
    ) -> Any:
        """Report why no member of a union fits: for the nearest one, or what would fit."""
        near = next((t for t in trials if t.problems[0].kind != "wrong-type"), None)
        if isinstance(node.value, list) or len(trials) == 1:
            near = near or trials[0]
        if near is None:
            return self._report_mismatch(mismatch(node, kind), path)
        self.problems += near.problems
        self.doubts.include(near.doubts)
        return _UNKNOWN


WITHOUT_DHCP = "use `whereabouts` or `static` with a range that your DHCP server does not give out"
ALLOY = "use `otel-collector`"

#: Paths from a job's options, "*" for any key; a value is the last step of its path.
ENDED: Mapping[tuple[str, ...], str] = {
    ("network", "ipvlan"): "use `macvlan`",
    ("network", "mode", "ipvlan"): "use `macvlan`",
    ("network", "ipam", "dhcp"): WITHOUT_DHCP,
    ("network", "install", "dhcp"): "remove it (nothing takes addresses from DHCP any more)",
    ("observability", "collector", "alloy"): ALLOY,
    ("observability", "alloy"): ALLOY,
    ("collector", "alloy"): ALLOY,  # a job of the stack's own
    ("alloy",): ALLOY,
}


def find_replacement(path: Path) -> str | None:
    """Return what replaces an option or value that ended; None: it is not such a one."""
    for ended, replacement in ENDED.items():
        if len(ended) == len(path) and all(
            word in ("*", step) for word, step in zip(ended, path, strict=True)
        ):
            return replacement
    return None
