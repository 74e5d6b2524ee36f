"""Results as columns of text for users, and as JSON for scripts."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
from itertools import zip_longest
from typing import Any

import attrs
import click

from rigel_k8s.cli.colors import WARNING
from rigel_k8s.cli.discovery import HEADS, cells, graph_json, graph_lines
from rigel_k8s.cli.gates import gate_lines
from rigel_k8s.cli.width import find_room, shorten, wrap
from rigel_k8s.discovery.findings import DiscoveryGraph
from rigel_k8s.objects.marks import REMEDY_ANNOTATION
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.release.status import AWAY, UNSEEN, PodStatus, ReleaseStatus, WorkloadStatus
from rigel_k8s.rosgraph.handover import GateStatus

#: The kind of a node that its roscore has forgotten: in ROS 1 nothing registers it again.
ORPHAN = "orphan"
GAP = "  "
#: Columns that a cell keeps, however narrow the terminal is.
LEAST = 8
#: What a narrow terminal does without, first the first.
OPTIONAL = ("IMAGE", "ROS NAME", "AGE", "INTERFACE")


def table(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    optional: Sequence[str] = (),
    colors: Sequence[str | None] = (),
) -> str:
    """Return rows below heads, in columns as wide as their widest cell.

    In a terminal a row is no longer than a line: the first optional column is left out, then the
    widest are narrowed, and where that is not enough, the other optional ones are left out.

    Args:
        colors: of the rows.
    """
    everything = [list(heads), *[list(row) for row in rows]]
    room = find_room(sys.stdout)
    for name in (None, *optional):
        if name in heads:
            left_out = everything[0].index(str(name))
            everything = [[*row[:left_out], *row[left_out + 1 :]] for row in everything]
        whole = [max(map(len, column)) for column in zip(*everything, strict=True)]
        # A narrowed name cannot be copied: rather than that, do without the first column.
        first = name is None and bool(optional)
        least = whole if first else [max(len(head), LEAST) for head in everything[0]]
        widths = narrow(whole, least, room)
        if room is None or line_width(widths) <= room:
            break
    lines = [
        GAP.join(shorten(cell, width).ljust(width) for cell, width in zip(row, widths, strict=True))
        for row in everything
    ]
    lines = [line.rstrip() for line in lines]
    lines[1:] = [
        click.style(line, fg=color) if color else line
        for line, color in zip_longest(lines[1:], colors)
    ]
    return "\n".join(lines)


def line_width(widths: Sequence[int]) -> int:
    """Return the columns that a row takes."""
    return sum(widths) + len(GAP) * (len(widths) - 1)


def narrow(widths: Sequence[int], least: Sequence[int], room: int | None) -> list[int]:
    """Return the widths of columns, the widest ones narrowed, but no further than needed."""
    found = list(widths)
    while room is not None and line_width(found) > room:
        wide = [(width, i) for i, width in enumerate(found) if width > least[i]]
        if not wide:
            break
        found[max(wide)[1]] -= 1
    return found


def status_text(
    found: ReleaseStatus,
    now: datetime | None = None,
    graph: DiscoveryGraph | None = None,
    gate: GateStatus | None = None,
) -> str:
    """Return a release's workloads and pods, and below them what is wrong."""
    now = now or datetime.now(timezone.utc)
    heads = ["NODE", "ROS NAME", "READY", "POD", "ON", "RESTARTS", "AGE", "IMAGE"]
    if graph is not None:
        heads[5:5] = HEADS
    rows: list[list[str]] = []
    colors: list[str | None] = []
    for workload in found.workloads:
        rows += rows_of(workload, now, graph)
        colors += [None if workload.ok else WARNING] * (len(rows) - len(colors))
    parts = [headline(found), table(heads, rows, OPTIONAL, colors) if rows else "nothing runs"]
    lines = [*reasons_of(found), *(graph_lines(graph) if graph is not None else ())]
    lines += gate_lines(gate, found) if gate is not None else ()
    reasons = "\n".join(click.style(wrap(reason, sys.stdout), fg=WARNING) for reason in lines)
    wrong = [part for part in (reasons, way_out(found)) if part] or [total(found)]
    drift = "\n".join(
        click.style(wrap(f"{w.name} {text}; `rigel run --adopt` undoes it", sys.stdout), fg=WARNING)
        for w in found.workloads
        for text in w.drift
    )
    return "\n\n".join(part for part in (*parts, *wrong, drift) if part)


def total(found: ReleaseStatus) -> str:
    """Return how many workloads are ready."""
    ready = sum(workload.ok for workload in found.workloads)
    text = f"{ready} of {len(found.workloads)} ready"
    if not found.workloads:
        return ""
    return click.style(text, fg="green") if ready == len(found.workloads) else text


def headline(found: ReleaseStatus) -> str:
    """Return the release and its revision."""
    where = f"release {found.release.name} in namespace {found.release.namespace}"
    if found.revision_status == UNSEEN:
        return f"{where}; its revision cannot be read (the right to list secrets is missing)"
    if not found.revision:
        return f"{where}: no revision"
    state = {"good": "", "pending": " (not finished)"}
    suffix = state.get(found.revision_status, f" ({found.revision_status})")
    old = f"; revision {found.good or 'before'} still runs" if found.keeps_old else ""
    return f"{where}, revision {found.revision}{suffix}{old}"


def rows_of(
    workload: WorkloadStatus, now: datetime, graph: DiscoveryGraph | None = None
) -> Iterator[list[str]]:
    """Yield a row for each pod of a workload, or one row without a pod."""
    ros_name = workload.annotations.get(ROS_NAME_ANNOTATION, "-")
    name = [workload.name, ros_name]
    for pod in workload.pods:
        on = pod.node or "-"
        place = [pod.name, on, *(cells(graph, pod.name) if graph is not None else ())]
        rest = [str(pod.restarts), age(pod.created, now), shorten_image(pod.image)]
        yield [*name, f"{int(pod.ready)}/1", *place, *rest]
    if not workload.pods:
        none = ["-"] * (5 + (len(HEADS) if graph is not None else 0))
        yield [*name, f"{workload.ready}/{workload.desired}", *none]


def reasons_of(found: ReleaseStatus) -> Iterator[str]:
    """Yield why something is not ready, nodes with one cause together."""
    alike: dict[str, list[str]] = {}
    for workload in found.workloads:
        if not workload.done and workload.message:
            alike.setdefault(workload.message, []).append(workload.name)
    for message, names in alike.items():
        yield f"{', '.join(names)}: {message}"
    for workload in found.workloads:
        if not workload.done and (remedy := workload.annotations.get(REMEDY_ANNOTATION)):
            yield f"{workload.name}: {remedy}"
        stranded = (pod for pod in workload.pods if pod.phase == "Terminating" and pod.kind == AWAY)
        for pod in (*find_unready(workload), *stranded):
            if pod.message and pod.message not in workload.message:
                yield f"{pod.name}: {pod.message}"


def find_unready(workload: WorkloadStatus) -> list[PodStatus]:
    """Return the pods that are not ready and should be; an ending one need not be."""
    return [pod for pod in workload.pods if not pod.ready and pod.phase != "Terminating"]


def way_out(found: ReleaseStatus) -> str:
    """Return the command that brings back nodes that roscore has forgotten."""
    orphans = [
        w.name for w in found.workloads if any(pod.kind == ORPHAN for pod in find_unready(w))
    ]
    if not orphans:
        return ""
    names = " ".join(orphans)
    count = "It comes" if len(orphans) == 1 else "They come"
    return (
        f"roscore has restarted and forgotten {names}. {count} back with\n"
        f"  kubectl -n {found.release.namespace} rollout restart deployment {names}"
    )


def age(created: str, now: datetime) -> str:
    """Return how long ago a Kubernetes time was: 42s, 12m, 5h, 3d."""
    try:
        then = datetime.strptime(created, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=timezone.utc)
    except ValueError:
        return "-"
    seconds = max(0, int((now - then).total_seconds()))
    for unit, size in (("d", 86400), ("h", 3600), ("m", 60)):
        if seconds >= 2 * size:
            return f"{seconds // size}{unit}"
    return f"{seconds}s"


def shorten_image(image: str) -> str:
    """Return an image with a digest short enough for a table."""
    name, at, digest = image.partition("@sha256:")
    return f"{name}{at}{digest[:7]}" if at else image or "-"


def status_json(
    found: ReleaseStatus, graph: DiscoveryGraph | None = None, gate: GateStatus | None = None
) -> dict[str, Any]:
    """Return a release for scripts (docs/cli.md)."""
    return {
        "release": found.release.name,
        "namespace": found.release.namespace,
        "revision": found.revision,
        "revision_status": found.revision_status,
        "good_revision": found.good,
        "ready": all(workload.ok for workload in found.workloads),
        "workloads": [workload_json(workload) for workload in found.workloads],
        "graph": graph_json(graph),
        "gate": None if gate is None else attrs.asdict(gate),
    }


def workload_json(workload: WorkloadStatus) -> dict[str, Any]:
    """Return a workload for scripts."""
    return {
        "kind": workload.kind,
        "name": workload.name,
        "ros_name": workload.annotations.get(ROS_NAME_ANNOTATION),
        "ready": workload.ready,
        "desired": workload.desired,
        "done": workload.done,
        "message": workload.message,
        "old_runs": workload.old_runs,
        "drift": list(workload.drift),
        "pods": [attrs.asdict(pod) for pod in workload.pods],
    }
