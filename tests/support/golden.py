"""Golden files: what is written as it is, and what differs from it.

A file has a YAML document for each object. One that resembles no other one is as it is. Of
another one a file has only what differs:

    like: nodes Deployment talker as camera  # of nodes.yaml, named camera wherever talker is;
                                      # "as camera-peer of camera": of the workload camera, too
    metadata:
      annotations: (removed)
      labels:
        arm: left                     # another value, or a key that the other one does not have
    spec:
      template:
        spec:
          containers:
          - name: ros-node            # a list whose items have names: all of it, in its order
            image: camera:2
          - = gate                    # an item that is the same
          - = first ... last          # all from one to another, as in the other list
    data:
      config.yaml: |                  # a text: what changes, and the lines around it
        (changed)
         scrape_configs:
        -  interval: 15s
        +  interval: 10s

    like: nodes Role a ... Service b  # all from one to another, as in nodes.yaml

A short list of plain values is in one line. So a probe that changes everywhere changes few files.
An object may resemble one of the models, an earlier one of its own file, or what an earlier file
has as it is. `--update-golden` writes them.
"""

from __future__ import annotations

import difflib
import functools
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s import yaml_text

REMOVED = "(removed)"
CHANGED = "(changed)"
TO = " ... "
AS, OF = " as ", " of "
#: What an item of a list may be called by.
NAMES = ("name", "mountPath")
#: An object is written whole if no more than this part of its lines would be left out.
LEAST = 0.3
#: How long the values of a list in one line may be together.
LONGEST = 80
IN_A_LINE = yaml.SequenceStartEvent(None, None, True, flow_style=True)


class Golden:
    """The golden files of a folder.

    Args:
        make: returns the objects of a case.
        models: the cases that are compared first, whose objects all others may resemble.
        cases: all cases.
    """

    def __init__(
        self,
        folder: Path,
        make: Callable[[str], Iterable[Any]],
        models: Sequence[str],
        cases: Iterable[str],
    ) -> None:
        self.folder, self.models = folder, models
        self.cases = [*models, *(case for case in cases if case not in models)]
        self.shorten = functools.cache(self.find_differences)
        self.make = functools.cache(lambda case: json.loads(json.dumps(list(make(case)))))

    def compare(self, case: str, *, update: bool) -> None:
        """Compare a case's objects with its file, or write it."""
        made, written = self.make(case), self.join(self.shorten(case))
        assert [one for item in written for one in self.restore(item)] == made
        text = documents(written)
        file = self.folder / f"{case}.yaml"
        if update:
            file.write_text(text, "utf-8")
        assert text == file.read_text("utf-8")

    def find_differences(self, case: str) -> list[Mapping[str, Any]]:
        """Return a case's objects by what differs: from others' that are whole, or earlier ones."""
        known: list[tuple[str, Any]] = []
        for other in self.cases[: self.cases.index(case)]:
            both = zip(self.make(other), self.shorten(other), strict=True)
            known += [(other, i) for i, written in both if other in self.models or i == written]
        written = []
        for item in self.make(case):
            written.append(find_shortest(item, known))
            known.append((case, item))
        return written

    def join(self, written: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """Return a single document for objects that are the same and in a row elsewhere, too."""
        joined: list[Mapping[str, Any]] = []
        before = ("", 0)  # the case and the number of what the last document ends with
        for item in written:
            place = self.find_same(item)
            if place[0] and place == (before[0], before[1] + 1):
                first = joined[-1]["like"].partition(TO)[0]
                joined[-1] = {"like": f"{first}{TO}{item['like'].partition(' ')[2]}"}
            else:
                joined.append(item)
            before = place
        return joined

    def find_same(self, item: Mapping[str, Any]) -> tuple[str, int]:
        """Return the case and the number of the object that this one is the same as, if any."""
        if item.keys() != {"like"} or AS in item["like"]:
            return "", 0
        case, _, wanted = item["like"].partition(" ")
        return case, [title(other) for other in self.make(case)].index(wanted)

    def restore(self, item: Mapping[str, Any]) -> list[Any]:
        """Return the objects that are written so."""
        if "like" not in item:
            return [item]
        case, _, wanted = item["like"].partition(" ")
        others = self.make(case)
        titles = [title(other) for other in others]
        if TO in wanted:
            first, last = map(titles.index, wanted.split(TO))
            return others[first : last + 1]
        wanted, _, names = wanted.partition(AS)
        other = others[titles.index(wanted)]
        change = {key: value for key, value in item.items() if key != "like"}
        return [apply(rename(other, names) if names else other, change)]


def documents(objects: Iterable[Mapping[str, Any]]) -> str:
    """Return objects as YAML, in the project's own way but for short lists of plain values."""
    stream = StringIO()
    dumper = yaml_text.Dumper(stream, width=yaml_text.WIDTH)
    dumper.open()
    for item in objects:
        dumper.emit(yaml.DocumentStartEvent(explicit=True))
        events: list[yaml.Event] = []
        yaml_text.emit_value(events.append, item)
        for place, event in enumerate(events):
            short = event is yaml_text.SEQUENCE and is_short(events[place + 1 :])
            dumper.emit(IN_A_LINE if short else event)
        dumper.emit(yaml.DocumentEndEvent(explicit=False))
    dumper.close()
    return stream.getvalue()


def is_short(events: Iterable[yaml.Event]) -> bool:
    """Whether a list, of whose content these are the events, has plain values that fit a line."""
    length = 0
    for event in events:
        if not isinstance(event, yaml.ScalarEvent) or "\n" in event.value or length > LONGEST:
            return event is yaml_text.SEQUENCE_END and length <= LONGEST
        length += len(event.value) + 2
    return False


def find_shortest(
    item: Mapping[str, Any], known: Iterable[tuple[str, Mapping[str, Any]]]
) -> Mapping[str, Any]:
    """Return an object by what differs from the one that it resembles most, or whole."""
    best, least = item, len(documents([item]).splitlines()) * (1 - LEAST)
    for case, other in known:
        if kind(other) != kind(item):
            continue
        like, names = f"{case} {title(other)}", OF.join(names_of(item))
        for old, text in ((other, like), (rename(other, names), f"{like}{AS}{names}")):
            made = {"like": text, **(differ(old, item) or {})}
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


def names_of(item: Any) -> list[str]:
    """Return an object's name, and its workload's if that is another one."""
    labels = item.get("metadata", {}).get("labels", {})
    name = title(item).split()[-1]
    return list(dict.fromkeys([name, labels.get("app.kubernetes.io/name", name)]))


def rename(item: Any, names: str) -> Any:
    """Return an object with another name, and workload, wherever its own ones stand in it."""
    text = json.dumps(item)
    for old, new in zip(names_of(item), names.split(OF), strict=False):
        text = re.sub(rf"(?<![\w-]){re.escape(old)}(?![\w-])", new, text)
    return json.loads(text)


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
    if is_text(old) and is_text(new):
        return differ_text(old, new)
    name = find_name(old, new)
    return differ_items(old, new, name) if name else new


def differ_items(old: Sequence[Any], new: Sequence[Any], name: str) -> list[Any]:
    """Return how a list is written beside another one, its items by their names."""
    known = {item[name]: item for item in old}
    places = {item[name]: place for place, item in enumerate(old)}
    made: list[Any] = []
    run: list[str] = []  # the names that the last item stands for
    for item in new:
        title = item[name]
        if title not in known:
            made.append(item)
        elif known[title] != item:
            made.append({name: title, **(differ(known[title], item) or {})})
        elif run and places[title] == places[run[-1]] + 1:
            run.append(title)
            made[-1] = f"= {run[0]}{TO}{title}"
            continue
        else:
            made.append(f"= {title}")
            run = [title]
            continue
        run = []
    return made


def differ_text(old: str, new: str) -> str:
    """Return how a text is written beside another one: as it is, if most of its lines change."""
    for context in (1, 3, 6):
        lines = list(difflib.unified_diff(old.split("\n"), new.split("\n"), n=context, lineterm=""))
        made = "\n".join(
            CHANGED if line.startswith("@@ ") else line.rstrip(" ") for line in lines[2:]
        )
        if len(lines) < len(new.split("\n")) * (1 - LEAST) and apply_text(old, made) == new:
            return made
    return new


def apply_text(old: str, change: str) -> str:
    """Return the text that `differ_text` has written so."""
    rest, made = old.split("\n"), []
    for part in f"\n{change}".split(f"\n{CHANGED}\n")[1:]:
        lines = part.split("\n")
        before = [line[1:] for line in lines if line[:1] != "+"]
        place = next(n for n in range(len(rest)) if rest[n : n + len(before)] == before)
        made += rest[:place] + [line[1:] for line in lines if line[:1] != "-"]
        rest = rest[place + len(before) :]
    return "\n".join(made + rest)


def apply(old: Any, change: Any) -> Any:
    """Return the value that `differ` has written so."""
    if isinstance(old, dict) and isinstance(change, dict):
        made = {key: value for key, value in old.items() if change.get(key) != REMOVED}
        parts = {key: value for key, value in change.items() if value != REMOVED}
        return made | {k: apply(old[k], v) if k in old else v for k, v in parts.items()}
    if is_text(old) and isinstance(change, str) and change.startswith(f"{CHANGED}\n"):
        return apply_text(old, change)
    name = next((n for n in NAMES if is_named(old, n) and is_written_by(n, old, change)), "")
    return apply_items(old, change, name) if name else change


def apply_items(old: Sequence[Any], change: Sequence[Any], name: str) -> list[Any]:
    """Return the list that `differ_items` has written so."""
    titles = [item[name] for item in old]
    known = dict(zip(titles, old, strict=True))
    made: list[Any] = []
    for item in change:
        if isinstance(item, str):
            first, _, last = item.removeprefix("= ").partition(TO)
            made += old[titles.index(first) : titles.index(last or first) + 1]
        else:
            made.append(apply(known[item[name]], item) if item[name] in known else item)
    return made


def find_name(old: Any, new: Any) -> str:
    """Return by which key the items of two lists are found, "" if by none."""
    return next((name for name in NAMES if is_named(old, name) and is_named(new, name)), "")


def is_text(value: Any) -> bool:
    """Whether a value is a text of lines."""
    return isinstance(value, str) and "\n" in value


def is_named(items: Any, name: str) -> bool:
    """Whether all items of a list have names of their own."""
    if not isinstance(items, list) or not items:
        return False
    if not all(isinstance(item, dict) and isinstance(item.get(name), str) for item in items):
        return False
    return len({item[name] for item in items}) == len(items)


def is_written_by(name: str, old: list[Any], change: Any) -> bool:
    """Whether a list is written by the names of its items."""
    known = {item[name] for item in old}
    return isinstance(change, list) and all(
        name in item
        if isinstance(item, dict)
        else isinstance(item, str) and known.issuperset(item.removeprefix("= ").split(TO))
        for item in change
    )
