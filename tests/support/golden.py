"""Golden files: a whole one for each shape, and what differs from it in the others.

A file has a YAML document for each object. Objects of a whole file are written as they are. In
another file, an object that resembles one of a whole file, or an earlier one of its own, has only
what differs:

    like: nodes Deployment talker       # of nodes.yaml; that is all if nothing differs
    metadata:
      name: camera                      # another value, or a key that the other one does not have
      annotations: (removed)
    spec:
      template:
        spec:
          containers:
          - name: ros-node              # a list whose items have names: all of it, in its order
            image: camera:2
          - = gate                      # an item that is the same

So a probe that changes everywhere changes the whole files only. `--update-golden` writes them.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rigel_k8s.yaml_text import documents

REMOVED = "(removed)"
#: What an item of a list may be called by.
NAMES = ("name", "mountPath")
#: An object is written whole if no more than this part of its lines would be left out.
LEAST = 0.3


class Golden:
    """The golden files of a folder.

    Args:
        make: returns the objects of a case.
        whole: the cases whose files are whole.
    """

    def __init__(
        self, folder: Path, make: Callable[[str], Iterable[Any]], whole: Sequence[str]
    ) -> None:
        self.folder, self.whole = folder, whole
        self.make = functools.cache(lambda case: json.loads(json.dumps(list(make(case)))))

    def compare(self, case: str, *, update: bool) -> None:
        """Compare a case's objects with its file, or write it."""
        made = self.make(case)
        written = made if case in self.whole else self.shorten(case)
        assert [self.restore(item) for item in written] == made
        text = documents(written)
        file = self.folder / f"{case}.yaml"
        if update:
            file.write_text(text, "utf-8")
        assert text == file.read_text("utf-8")

    def shorten(self, case: str) -> list[Mapping[str, Any]]:
        """Return a case's objects by what differs: from whole ones, or from earlier ones here."""
        known = [(other, item) for other in self.whole for item in self.make(other)]
        written = []
        for item in self.make(case):
            written.append(find_shortest(item, known))
            known.append((case, item))
        return written

    def restore(self, item: Mapping[str, Any]) -> Any:
        """Return the object that is written so."""
        if "like" not in item:
            return item
        case, _, wanted = item["like"].partition(" ")
        (other,) = (other for other in self.make(case) if title(other) == wanted)
        return apply(other, {key: value for key, value in item.items() if key != "like"})


def find_shortest(
    item: Mapping[str, Any], known: Iterable[tuple[str, Mapping[str, Any]]]
) -> Mapping[str, Any]:
    """Return an object by what differs from the one that it resembles most, or whole."""
    best, least = item, len(documents([item]).splitlines()) * (1 - LEAST)
    for case, other in known:
        if kind(other) != kind(item):
            continue
        made = {"like": f"{case} {title(other)}", **(differ(other, item) or {})}
        lines = len(documents([made]).splitlines())
        if lines < least:
            best, least = made, lines
    return best


def kind(item: Mapping[str, Any]) -> Any:
    """Return what only objects that may resemble each other share."""
    return item.get("kind") or next(iter(item))


def title(item: Mapping[str, Any]) -> str:
    """Return what identifies an object in its file."""
    if "kind" in item:
        return f"{item['kind']} {item['metadata']['name']}"
    return " ".join(map(str, next(iter(item.items()))))


def differ(old: Any, new: Any) -> Any:
    """Return how a value is written beside another one; None if they are the same."""
    if old == new:
        return None
    if isinstance(old, dict) and isinstance(new, dict):
        parts = {
            key: differ(old[key], value) if key in old else value for key, value in new.items()
        }
        changed = {k: v for k, v in parts.items() if v is not None or k not in old}
        return {**changed, **{key: REMOVED for key in old if key not in new}}
    name = find_name(old, new)
    if not name:
        return new
    known = {item[name]: item for item in old}
    return [
        {name: item[name], **(differ(known[item[name]], item) or {})}
        if item[name] in known and known[item[name]] != item
        else f"= {item[name]}"
        if item[name] in known
        else item
        for item in new
    ]


def apply(old: Any, change: Any) -> Any:
    """Return the value that `differ` has written so."""
    if isinstance(old, dict) and isinstance(change, dict):
        made = {key: value for key, value in old.items() if change.get(key) != REMOVED}
        parts = {key: value for key, value in change.items() if value != REMOVED}
        return made | {k: apply(old[k], v) if k in old else v for k, v in parts.items()}
    name = next((n for n in NAMES if is_named(old, n) and is_written_by(n, old, change)), "")
    if name:
        known = {item[name]: item for item in old}
        return [
            known[item.removeprefix("= ")]
            if isinstance(item, str)
            else apply(known[item[name]], item)
            if item[name] in known
            else item
            for item in change
        ]
    return change


def find_name(old: Any, new: Any) -> str:
    """Return by which key the items of two lists are found, "" if by none."""
    return next((name for name in NAMES if is_named(old, name) and is_named(new, name)), "")


def is_named(items: Any, name: str) -> bool:
    """Whether all items of a list have names of their own."""
    if not isinstance(items, list) or not items:
        return False
    if not all(isinstance(item, dict) and isinstance(item.get(name), str) for item in items):
        return False
    return len({item[name] for item in items}) == len(items)


def is_written_by(name: str, old: list[Any], change: Any) -> bool:
    """Whether a list is written by the names of its items."""
    known = {f"= {item[name]}" for item in old}
    return isinstance(change, list) and all(
        name in item if isinstance(item, dict) else item in known for item in change
    )
