"""render, diff, history, restart, rollback, down: the commands about a release."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s import deploy as deploys
from rigel_k8s.commands.interruption import writing
from rigel_k8s.commands.pods import choose_pods
from rigel_k8s.commands.targets import Release, job_of, release
from rigel_k8s.errors import ConflictError
from rigel_k8s.kube import connect
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release import development as restarts
from rigel_k8s.release import rollback as rollbacks
from rigel_k8s.release.difference import compare_objects, difference
from rigel_k8s.release.hiding import hide
from rigel_k8s.release.history import Entry, History
from rigel_k8s.release.look import look
from rigel_k8s.release.revisions import Record, records
from rigel_k8s.release.status import no_release_error
from rigel_k8s.release.types import DeployOptions, Plan, Revision, Step
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings


@attrs.frozen
class Manifests:
    """What apply would send, and the warnings of the job's check."""

    objects: tuple[Manifest, ...]
    warnings: tuple[str, ...]


@attrs.frozen
class Difference:
    """What a job would do to each object.

    Attributes:
        text: the changes as a text, "" if nothing changes.
        conflict: why a deploy without `--adopt` would be refused: others own some of it.
    """

    steps: tuple[Step, ...]
    text: str
    warnings: tuple[str, ...]
    conflict: ConflictError | None = None


def render(settings: Settings, job: str | None, data: Mapping[str, Any] | None = None) -> Manifests:
    """Return the manifests that apply would send: what the network needs first, the stack last.

    The cluster is read only if the Rigelfile is not enough: a job that describes a part of a
    release is merged into the release's last revision. What applications share is as this job
    requests it; on a cluster it is merged into what others have requested.

    Args:
        data: what a sequence passes to the job: `{{ data.KEY }}`.
    """
    target = job_of(settings, job, data)
    manifests = deploys.render(target.list_parts(None))
    return Manifests(manifests, tuple(target.warnings.texts))


def diff(settings: Settings, job: str | None, data: Mapping[str, Any] | None = None) -> Difference:
    """Return what a job would change on the cluster; nothing is written. `data` as in render.

    Raises: as `run` does before its first write.
    """
    target = job_of(settings, job, data)
    warnings = target.warnings
    options = DeployOptions(report=warnings, adopt=settings.adopt)
    with connect(settings) as cluster:
        parts = target.list_parts(cluster)
        conflict = None
        try:
            looks = look(parts, cluster, options)
        except ConflictError as error:
            conflict = error
            looks = look(parts, cluster, attrs.evolve(options, adopt=True))
    for one in looks:
        warnings.texts += one.warnings
    steps = tuple(step for one in looks for step in one.plan.steps)
    return Difference(steps, difference(steps), tuple(warnings.texts), conflict)


def history(settings: Settings, job: str | None) -> Sequence[Entry]:
    """Return a release's revisions, oldest first.

    Raises:
        UserError: the release has no revision.
    """
    return History(ROS_NAME_ANNOTATION).make_entries(read_records(settings, job))


def show(settings: Settings, job: str | None, number: int) -> tuple[Entry, Revision]:
    """Return one revision of a release, and what it changed; options without their secrets.

    Raises:
        UserError: the release has no such revision.
    """
    known = read_records(settings, job)
    revision = choose(known, number)
    [entry] = [
        one for one in History(ROS_NAME_ANNOTATION).make_entries(known) if one.number == number
    ]
    return entry, attrs.evolve(revision, options=hide(revision.options))


def compare(settings: Settings, job: str | None, old: int, new: int | None) -> str:
    """Return what differs in two revisions as a unified diff; None is the newest one.

    Raises:
        UserError: the release has no such revision.
    """
    known = read_records(settings, job)
    before, after = choose(known, old), choose(known, new or known[-1].number)
    names = f"revision {before.number}", f"revision {after.number}"
    return compare_objects(before.objects, after.objects, names)


def read_records(settings: Settings, job: str | None) -> Sequence[Record]:
    """Return the records of a release, oldest first.

    Raises:
        UserError: it has none.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        known = records(cluster, found.id)
    if not known:
        raise no_release_error(found.id)
    return known


def choose(known: Sequence[Record], number: int) -> Revision:
    """Return a revision by its number."""
    for record in known:
        if record.number == number:
            return record.revision()
    raise rollbacks.no_revision_error(known, known[0].release, f"no revision {number}")


def rollback(
    found: Release,
    settings: Settings,
    number: int | None,
    report: Reporter,
    cancel: threading.Event | None = None,
) -> Revision:
    """Deploy an earlier revision's objects again; None is the last good one before the current.

    Closes the connection; `cancel` as in writing.
    """
    with writing(found.cluster, settings, report, cancel) as options:
        return deploys.roll_back(found.cluster, found.id, number, options)


def restart(
    found: Release,
    settings: Settings,
    nodes: Sequence[str],
    report: Reporter,
    cancel: threading.Event | None = None,
) -> None:
    """Replace the pods of some nodes, as in an update, or run tasks again. Otherwise as rollback.

    Raises:
        UserError: the release has no such node.
    """
    with writing(found.cluster, settings, report, cancel) as options:
        chosen = {pod.owner for pod in choose_pods(found, nodes)}
        refs = sorted(chosen, key=lambda ref: ref.name)
        restarts.restart(found.cluster, found.id, refs, options)


def down(
    found: Release,
    settings: Settings,
    report: Reporter,
    cancel: threading.Event | None = None,
    *,
    volumes: bool,
) -> Plan:
    """Delete a release's objects; claims and volumes only if requested. Otherwise as rollback."""
    with writing(found.cluster, settings, report, cancel) as options:
        return deploys.down(found.cluster, found.id, options, volumes=volumes)
