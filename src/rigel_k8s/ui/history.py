"""The revisions of a release, and what each changed, as a page shows them; pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.order import WORKLOADS
from rigel_k8s.release.revisions import CREATED, DESCRIPTION, Record


class History:
    """Revisions as entries; each is decompressed once."""

    def __init__(self) -> None:
        self._workloads: dict[int, dict[str, Manifest]] = {}

    def make_entries(self, records: Sequence[Record]) -> dict[str, Any]:
        """Return the entries of a release's records, the oldest first."""
        made: dict[str, Any] = {}
        numbers = [record.number for record in records]
        self._workloads = {n: found for n, found in self._workloads.items() if n in numbers}
        for record in records:
            if record.number not in self._workloads:
                self._workloads[record.number] = read_workloads(record)
        now = numbers[-1] if numbers else 0
        for record, before in zip(records, [None, *numbers[:-1]], strict=True):
            notes = record.secret["metadata"].get("annotations") or {}
            made[f"revision/{record.number}"] = {
                "number": record.number,
                "status": record.status,
                "created": notes.get(CREATED, ""),
                "description": notes.get(DESCRIPTION, ""),
                "changes": [] if before is None else self.compare(before, record.number),
                "back": [] if record.number == now else self.compare(now, record.number),
            }
        return made

    def compare(self, old: int, new: int) -> list[str]:
        """Return what differs in the workloads of two revisions."""
        return list(compare(self._workloads[old], self._workloads[new]))


def read_workloads(record: Record) -> dict[str, Manifest]:
    """Return a revision's workloads by name; none where it cannot be read."""
    try:
        objects = record.revision().objects
    except RigelK8sError:
        return {}
    return {live["metadata"]["name"]: live for live in objects if live["kind"] in WORKLOADS}


def compare(old: dict[str, Manifest], new: dict[str, Manifest]) -> Iterator[str]:
    """Yield what differs in two revisions' workloads, by name."""
    for name in sorted({*old, *new}):
        if name not in old:
            yield f"{show_name(new[name])} is new"
        elif name not in new:
            yield f"{show_name(old[name])} is removed"
        elif old[name] != new[name]:
            words = ", ".join(compare_workload(old[name], new[name]))
            yield f"{show_name(new[name])}: {words}"


def compare_workload(old: Manifest, new: Manifest) -> Iterator[str]:
    """Yield what differs in a workload: its images and replicas by name, anything else as one."""
    before, after = dict(images(old)), dict(images(new))
    known = False
    for container in before.keys() & after.keys():
        if before[container] != after[container]:
            known = True
            yield f"image {shorten(before[container])} to {shorten(after[container])}"
    counts = [live.get("spec", {}).get("replicas", 1) for live in (old, new)]
    if counts[0] != counts[1]:
        known = True
        yield f"{counts[0]} to {counts[1]} replicas"
    if not known:
        yield "changed"


def images(workload: Manifest) -> Iterable[tuple[str, str]]:
    """Yield the names and images of a workload's containers."""
    pod = workload.get("spec", {}).get("template", {}).get("spec", {})
    for container in pod.get("containers") or []:
        yield container["name"], container.get("image", "")


def shorten(image: str) -> str:
    """Return an image with a short digest."""
    name, at, digest = image.partition("@sha256:")
    return f"{name}{at}{digest[:7]}" if at else image


def show_name(workload: Manifest) -> str:
    """Return the ROS name of a workload, or its own."""
    meta = workload["metadata"]
    return str((meta.get("annotations") or {}).get(ROS_NAME_ANNOTATION) or meta["name"])
