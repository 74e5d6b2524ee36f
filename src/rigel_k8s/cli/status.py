"""`rigel status`: workloads and pods in columns, what is wrong below them; and as JSON."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any

import attrs
import click

from rigel_k8s.cli.tables import age, seconds_since, table
from rigel_k8s.cli.width import WARNING, wrap
from rigel_k8s.cli.words import (
    json_option,
    namespace_option,
    print_json,
    release_argument,
    settings,
)
from rigel_k8s.objects.marks import DEVELOPMENT_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.text import join_words
from rigel_k8s.release.status import AWAY, UNSEEN, PodStatus, ReleaseStatus, WorkloadStatus

if TYPE_CHECKING:
    from rigel_k8s.app.deploying.guests import StatusAddition
    from rigel_k8s.commands.status import Status

#: The kind of a node that its roscore has forgotten: in ROS 1 nothing registers it again.
ORPHAN = "orphan"
#: Seconds for which a crash that was overcome is of interest.
LATELY = 3600
#: What a narrow terminal does without, first the first; guests have some of these columns.
OPTIONAL = ("IMAGE", "INTERFACE", "ADDRESS", "ROS NAME", "POD", "AGE")
#: The same while a node has several pods, as in a roll-out: only by their names rows differ.
OPTIONAL_BUT_PODS = (*OPTIONAL[:4], "DISCOVERED", "RESTARTS", "ON", "AGE")
#: What is left out rather than narrowed, since it is copied; a node's name is always there.
WHOLE = ("NODE", "POD")
#: The parts of the JSON that guests have; null where they were not asked.
OF_GUESTS = ("graph", "gate", "clocks", "expect")


@click.command()
@release_argument
@namespace_option
@json_option
@click.option(
    "--no-graph",
    is_flag=True,
    help="Skip what is read from inside pods: DDS discovery, the gate, clocks.",
)
@click.pass_context
def status(ctx: click.Context, /, job: str | None, output: str, no_graph: bool) -> int:  # noqa: FBT001
    """Show what runs where, and what is wrong. Exit code 1 if anything is."""
    from rigel_k8s.commands import status as reading

    found = reading.status(settings(ctx), job, graph=not no_graph)
    if output == "json":
        print_json(status_json(found))
    else:
        click.echo(status_text(found))
    return 0 if found.ok else 1


def status_text(status: Status, now: datetime | None = None) -> str:
    """Return a release's workloads and pods, and below them what is wrong."""
    found, additions = status.release, status.additions
    now = now or datetime.now(timezone.utc)
    heads = ["NODE", "ROS NAME", "READY", "POD", "ON", "RESTARTS", "AGE", "IMAGE"]
    heads[5:5] = [head for one in additions for head in one.heads]
    rows: list[list[str]] = []
    colors: list[str | None] = []
    for workload in found.workloads:
        rows += rows_of(workload, now, additions)
        colors += [None if workload.ok else WARNING] * (len(rows) - len(colors))
    several = any(len(workload.pods) > 1 for workload in found.workloads)
    optional = OPTIONAL_BUT_PODS if several else OPTIONAL
    parts = [
        headline(found),
        table(heads, rows, optional, colors, WHOLE) if rows else "nothing runs",
    ]
    lines = [
        *found.missing,
        *found.changed,
        *reasons_of(found),
        *stop_lines(found, now),
        *rollback_lines(found),
        *(line for one in additions for line in one.lines),
    ]
    notes = "\n".join(wrap(note, sys.stdout) for one in additions for note in one.notes)
    reasons = "\n".join(click.style(wrap(reason, sys.stdout), fg=WARNING) for reason in lines)
    wrong = [part for part in (reasons, way_out(found)) if part] or [total(found)]
    drift = "\n".join(
        click.style(wrap(f"{w.name} {text}; `rigel run --adopt` undoes it", sys.stdout), fg=WARNING)
        for w in found.workloads
        for text in w.drift
    )
    # The nodes of one pod have one note.
    texts = {w.annotations.get(DEVELOPMENT_ANNOTATION, "") for w in found.workloads} - {""}
    developed = "\n".join(click.style(wrap(text, sys.stdout), fg=WARNING) for text in sorted(texts))
    return "\n\n".join(part for part in (*parts, notes, *wrong, drift, developed) if part)


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
    suffix = "" if found.revision_status == "good" else f" ({found.revision_status})"
    keeps = found.keeps_old and found.good != found.revision
    names = [one.name for one in found.workloads if one.old_runs]
    of = f"of {join_words(names)} " if len(names) < len(found.workloads) else ""
    old = f"; {of}revision {found.good or 'before'} still runs" if keeps else ""
    return f"{where}, revision {found.revision}{suffix}{old}"


def rows_of(
    workload: WorkloadStatus, now: datetime, additions: Sequence[StatusAddition] = ()
) -> Iterator[list[str]]:
    """Yield a row for each pod of a workload, or one row without a pod."""
    ros_name = workload.annotations.get(ROS_NAME_ANNOTATION, "-")
    name = [workload.name, ros_name]
    for pod in workload.pods:
        cells = [cell for one in additions for cell in one.find_cells(pod.name, workload.name)]
        place = [pod.name, pod.node or "-", *cells]
        rest = [str(pod.restarts), age(pod.created, now), shorten_image(pod.image)]
        ready = "done" if pod.phase == "Succeeded" else f"{int(pod.ready)}/1"
        yield [*name, ready, *place, *rest]
    if not workload.pods:
        none = ["-"] * (5 + sum(len(one.heads) for one in additions))
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


def stop_lines(found: ReleaseStatus, now: datetime) -> Iterator[str]:
    """Yield which pods' containers a liveness probe has stopped last, or have crashed lately."""
    for workload in found.workloads:
        for pod in workload.pods:
            if pod.stopped and pod.phase != "Terminating":
                how = f"{'restarted' if pod.ready else 'stopped'} by its liveness probe"
                yield f"{pod.name}: {how} {age(pod.stopped, now)} ago: {pod.not_alive}"
            elif (since := seconds_since(pod.crashed, now)) is not None and since < LATELY:
                yield f"{pod.name}: started again {age(pod.crashed, now)} ago: {pod.crash}"


def rollback_lines(found: ReleaseStatus) -> Iterator[str]:
    """Yield that the last update was rolled back, and why."""
    if undone := found.rolled_back:
        cause = undone.cause and f": {undone.cause}"
        yield f"revision {undone.revision} was rolled back to revision {undone.to}{cause}"


def find_unready(workload: WorkloadStatus) -> list[PodStatus]:
    """Return the pods that are not ready and should be; one that ends or is done need not be."""
    over = ("Terminating", "Succeeded")
    return [pod for pod in workload.pods if not pod.ready and pod.phase not in over]


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
        f"  rigel -n {found.release.namespace} restart --release {found.release.name} {names}"
    )


def shorten_image(image: str) -> str:
    """Return an image with a digest short enough for a table."""
    name, at, digest = image.partition("@sha256:")
    return f"{name}{at}{digest[:7]}" if at else image or "-"


def status_json(status: Status) -> dict[str, Any]:
    """Return a release for scripts (docs/cli.md)."""
    found = status.release
    return {
        "release": found.release.name,
        "namespace": found.release.namespace,
        "revision": found.revision,
        "revision_status": found.revision_status,
        "good_revision": found.good,
        "rolled_back": found.rolled_back and attrs.asdict(found.rolled_back),
        "ready": found.ok,
        "missing": list(found.missing),
        "changed": list(found.changed),
        "workloads": [workload_json(workload) for workload in found.workloads],
        **dict.fromkeys(OF_GUESTS),
        **{key: part for one in status.additions for key, part in one.json.items()},
    }


def workload_json(workload: WorkloadStatus) -> dict[str, Any]:
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
        "development": workload.annotations.get(DEVELOPMENT_ANNOTATION),
        "pods": [attrs.asdict(pod) for pod in workload.pods],
    }
