"""The revisions of a release, who made each, and what it changed; pure."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.objects.podnodes import split_all
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.text import plural
from rigel_k8s.release.hiding import hide
from rigel_k8s.release.revisions import BY, CREATED, DAMAGES, DESCRIPTION, Record, find_good
from rigel_k8s.release.types import WORKLOADS

#: The key of a volume that has its files: (mode, content) by path.
FILES = "files"
#: Files of one volume that are named; more are counted.
MOST_FILES = 3
#: Characters of an option's value that are shown.
LONGEST = 40
#: The value of an option that is not there.
UNSET: Any = object()


@attrs.frozen
class Entry:
    """One revision.

    Attributes:
        status: pending, interrupted, good, failed or superseded.
        by: user@machine of the process that made it, "" if it does not say so.
        images: those of its workloads, each once.
        changes: what it changed, a line for each option and workload.
        back: what a rollback to it would change.
    """

    number: int
    status: str
    created: str
    by: str
    description: str
    images: tuple[str, ...]
    changes: tuple[str, ...]
    back: tuple[str, ...]


@attrs.frozen
class Content:
    """What a revision has: the options of its job, and its workloads by name."""

    options: Mapping[str, Any] = attrs.field(factory=dict)
    workloads: Mapping[str, Manifest] = attrs.field(factory=dict)


class History:
    """Revisions as entries; each is decompressed once.

    Args:
        naming: the annotation that has the name by which users know a workload.
    """

    def __init__(self, naming: str = "") -> None:
        self._naming = naming
        self._contents: dict[int, Content] = {}

    def make_entries(self, records: Sequence[Record]) -> list[Entry]:
        """Return the entries of a release's records, the oldest first."""
        numbers = [record.number for record in records]
        self._contents = {n: found for n, found in self._contents.items() if n in numbers}
        for record in records:
            if record.number not in self._contents:
                self._contents[record.number] = read_content(record)
        now = numbers[-1] if numbers else 0
        last_good = find_good(records)
        return [
            self.make_entry(record, before, now, replaced=record.number < last_good)
            for record, before in zip(records, [None, *numbers], strict=False)
        ]

    def make_entry(self, record: Record, before: int | None, now: int, *, replaced: bool) -> Entry:
        number, notes = record.number, record.secret["metadata"].get("annotations") or {}
        workloads = self._contents[number].workloads.values()
        found = [image for live in workloads for image in images(live).values()]
        return Entry(
            number,
            "superseded" if replaced and record.status == "good" else record.status,
            notes.get(CREATED, ""),
            notes.get(BY, ""),
            notes.get(DESCRIPTION, ""),
            tuple(sorted({*map(shorten, found)})),
            () if before is None else self.compare(before, number),
            () if number == now else self.compare(now, number),
        )

    def compare(self, old: int, new: int) -> tuple[str, ...]:
        """Return what differs in two revisions."""
        try:
            return tuple(compare(self._contents[old], self._contents[new], self._naming))
        except DAMAGES:  # someone has written into a record
            return ("changed",)


def read_content(record: Record) -> Content:
    """Return a revision's options and workloads; none where it cannot be read."""
    try:
        revision = record.revision()
        objects = revision.objects
        workloads = [live for live in objects if live["kind"] in WORKLOADS]
        configs = {one["metadata"]["name"]: one for one in objects if one["kind"] == "ConfigMap"}
        for live in workloads:
            pod = live.get("spec", {}).get("template", {}).get("spec", {})
            pod["volumes"] = [read_files(one, configs) for one in pod.get("volumes") or []]
            list(map(shorten, images(live).values()))
        named = {live["metadata"]["name"]: live for live in split_all(workloads)}
        return Content(revision.options, named)
    except (RigelK8sError, *DAMAGES):
        return Content()


def read_files(volume: Manifest, configs: Mapping[str, Manifest]) -> Manifest:
    """Return a volume; one that lists files of a ConfigMap has these in place of the latter."""
    source = volume.get("configMap") or {}
    if "items" not in source or source.get("name") not in configs:
        return volume
    config = configs[source["name"]]
    content = {**(config.get("data") or {}), **(config.get("binaryData") or {})}
    items = {item["path"]: (item.get("mode"), content.get(item["key"])) for item in source["items"]}
    return {"name": volume["name"], FILES: items}


def compare(old: Content, new: Content, naming: str) -> Iterator[str]:
    """Yield what differs in two revisions: options with their values, then workloads by name.

    What differs in the options explains what differs in pods, except images and files.
    """
    wished = list(compare_options(old.options, new.options))
    yield from wished
    before, after = old.workloads, new.workloads
    for name in sorted({*before, *after}):
        if name not in before:
            yield f"{show_name(after[name], naming)} is new"
        elif name not in after:
            yield f"{show_name(before[name], naming)} is removed"
        elif before[name] != after[name]:
            words = list(dict.fromkeys(compare_workload(before[name], after[name])))
            kept = [word for word in words if not wished or word.startswith(("image ", "/"))]
            if kept or not wished:
                yield f"{show_name(after[name], naming)}: {', '.join(kept) or 'changed'}"


def compare_options(
    old: Mapping[str, Any], new: Mapping[str, Any], path: tuple[str, ...] = ()
) -> Iterator[str]:
    """Yield the options that differ, with their values: `brake.parameters.limit: 1.8 to 1.6`.

    Nodes that are new or removed are left out: their workloads are.
    """
    for key in sorted({*map(str, old), *map(str, new)}):
        before, after, place = old.get(key, UNSET), new.get(key, UNSET), (*path, key)
        same = before == after and json.dumps(before) == json.dumps(after)  # 10 is not 10.0
        if same or (path == ("nodes",) and UNSET in (before, after)):
            continue
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            yield from compare_options(before, after, place)
            continue
        name = ".".join(place[1:] if place[0] == "nodes" else place)
        was, now = (
            "" if one is UNSET else show(hide({key: one}, key=path[-1] if path else "")[key])
            for one in (before, after)
        )
        if was == now:
            yield f"{name}: another value"
        elif before is UNSET:
            yield f"{name}: {now} is new"
        elif after is UNSET:
            yield f"{name}: {was} is removed"
        else:
            yield f"{name}: {was} to {now}"


def show(value: Any) -> str:
    """Return a value as a Rigelfile has it, on one short line."""
    text = value if isinstance(value, str) else json.dumps(value)
    text = " ".join(text.split())
    return f"{text[: LONGEST - 1]}…" if len(text) > LONGEST else text or '""'


def compare_workload(old: Manifest, new: Manifest) -> Iterator[str]:
    """Yield what differs in a workload: images, replicas, then the names of other keys."""
    before, after = images(old), images(new)
    for container in before.keys() & after.keys():
        if before[container] != after[container]:
            yield f"image {shorten(before[container])} to {shorten(after[container])}"
    counts = [live.get("spec", {}).get("replicas", 1) for live in (old, new)]
    if counts[0] != counts[1]:
        yield f"{counts[0]} to {counts[1]} replicas"
    yield from list_keys(old.get("spec", {}), new.get("spec", {}))


def list_keys(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of the other keys that differ in a workload or its pods."""
    for key in sorted({*old, *new} - {"replicas", "image"}):
        before, after = old.get(key), new.get(key)
        if before == after:
            continue
        if key in ("template", "spec", "metadata", "annotations"):
            yield from list_keys(before or {}, after or {})
        elif key in ("containers", "env", "volumes"):
            named = [{item["name"]: item for item in side or ()} for side in (before, after)]
            for name in sorted({*named[0], *named[1]}):
                one, other = (side.get(name) for side in named)
                if key == "containers" and one and other:
                    yield from list_keys(one, other)
                elif key == "volumes" and one != other:
                    yield list_files((one or {}).get(FILES), (other or {}).get(FILES))
                elif one != other:
                    yield f"env {name}" if key == "env" else f"container {name}"
        else:
            yield key.rpartition("/")[2]


def list_files(old: Mapping[str, Any] | None, new: Mapping[str, Any] | None) -> str:
    """Return the files that differ in two volumes, if both are of files."""
    if old is None or new is None:
        return "volumes"
    changed = [path for path in sorted({*old, *new}) if old.get(path) != new.get(path)]
    return ", ".join(changed) if len(changed) <= MOST_FILES else plural(len(changed), "file")


def images(workload: Manifest) -> dict[str, str]:
    """Return the images of a workload's containers by their names."""
    pod = workload.get("spec", {}).get("template", {}).get("spec", {})
    return {one["name"]: one.get("image", "") for one in pod.get("containers") or []}


def shorten(image: str) -> str:
    """Return an image with a short digest."""
    name, at, digest = image.partition("@sha256:")
    return f"{name}{at}{digest[:7]}" if at else image


def show_name(workload: Manifest, naming: str) -> str:
    """Return the name by which users know a workload, or its own."""
    meta = workload["metadata"]
    return str((meta.get("annotations") or {}).get(naming) or meta["name"])
