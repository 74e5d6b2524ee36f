"""render, diff, history, rollback, down: the commands about a release."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.deploying.prepare import prepare
from rigel_k8s.app.partial import flat, is_partial
from rigel_k8s.commands import stacks
from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.commands.targets import Release, job_of, release
from rigel_k8s.errors import ConflictError
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.kube import connect
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.observability.request import StackRequest, request_of
from rigel_k8s.release import deploy as deploys
from rigel_k8s.release import removal
from rigel_k8s.release import rollback as rollbacks
from rigel_k8s.release.difference import difference
from rigel_k8s.release.labelling import manifests_to_apply
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.types import DeployOptions, Plan, Revision
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings


@attrs.frozen
class Manifests:
    """What apply would send, and the warnings of the job's check."""

    objects: tuple[Manifest, ...]
    warnings: tuple[str, ...]


@attrs.frozen
class Difference:
    """What a job would change.

    Attributes:
        text: the plan as a text, "" if nothing changes.
        conflict: why a deploy without `--adopt` would be refused: others own some of it.
    """

    plan: Plan
    text: str
    warnings: tuple[str, ...]
    conflict: ConflictError | None = None


def render(settings: Settings, job: str | None, data: Mapping[str, Any] | None = None) -> Manifests:
    """Return the manifests that apply would send, those of the observability stack first.

    The cluster is read only if the Rigelfile is not enough: a job that describes a part of a
    release is merged into the release's last revision. The stack is what this job requests; on a
    cluster it is merged into what others have requested.

    Args:
        data: what a sequence passes to the job: `{{ data.KEY }}`.
    """
    rigelfile = load(settings)
    if alone := stacks.stack_job(rigelfile, settings, job, data):
        return Manifests(stacks.manifests(request_of(alone.raw)), alone.warnings)
    found = job_of(settings, job, rigelfile, data)
    if found.options.observability_only:
        return Manifests(stacks.manifests(stack_request_of(found.raw)), found.warnings)
    cluster = connect(settings) if is_partial(found.raw) else None
    made = prepare(found.options, found.raw, found.application, settings, cluster)
    objects = () if made.stack is None else stacks.manifests(made.stack)
    return Manifests((*objects, *manifests_to_apply(made.desired)), found.warnings)


def diff(settings: Settings, job: str | None, data: Mapping[str, Any] | None = None) -> Difference:
    """Return what a job would change on the cluster; nothing is written. `data` as in render."""
    rigelfile = load(settings)
    if alone := stacks.stack_job(rigelfile, settings, job, data):
        with connect(settings) as cluster:
            return describe(
                stacks.plan(request_of(alone.raw), cluster, adopt=settings.adopt), alone.warnings
            )
    found = job_of(settings, job, rigelfile, data)
    with connect(settings) as cluster:
        if found.options.observability_only:
            stack = stack_request_of(found.raw)
            return describe(stacks.plan(stack, cluster, adopt=settings.adopt), found.warnings)
        made = prepare(found.options, found.raw, found.application, settings, cluster)
        conflict = None
        try:
            try:
                plan = deploys.diff(made.desired, cluster, adopt=settings.adopt)
            except ConflictError as error:
                conflict = error
                plan = deploys.diff(made.desired, cluster, adopt=True)
        except Refused as refused:
            refused.details = tuple(found.place(refused.problems))
            raise
        if made.stack is not None:
            first = stacks.plan(made.stack, cluster, adopt=settings.adopt)
            plan = attrs.evolve(plan, steps=(*first.steps, *plan.steps))
    return attrs.evolve(describe(plan, found.warnings), conflict=conflict)


def describe(plan: Plan, warnings: tuple[str, ...]) -> Difference:
    """Return a plan with its text."""
    return Difference(plan, difference(plan), warnings)


def stack_request_of(raw: Mapping[str, Any]) -> StackRequest:
    """Return what an orchestration job requests of the observability stack."""
    return request_of(flat(raw).get("observability") or {})


def history(settings: Settings, job: str | None) -> Sequence[Revision]:
    """Return a release's revisions, oldest first."""
    found = release(settings, job)
    with found.cluster as cluster:
        return deploys.history(cluster, found.id)


def rollback(
    settings: Settings, job: str | None, number: int | None, report: JobReporter
) -> Revision:
    """Deploy an earlier revision's objects again; None is the last good one before the current."""
    found = release(settings, job, named=True)
    with interruptible() as cancel:
        return roll_back(found, settings, number, report, cancel)


def roll_back(
    found: Release,
    settings: Settings,
    number: int | None,
    report: Reporter,
    cancel: threading.Event,
) -> Revision:
    """Roll back a release that is connected, whose connection is then closed."""
    with found.cluster as cluster:
        cluster.endure(report.line, cancel)
        options = DeployOptions.of(settings, report, cancel)
        return rollbacks.rollback(cluster, found.id, number, options)


def down(found: Release, settings: Settings, report: JobReporter, *, volumes: bool) -> Plan:
    """Delete a release's objects; claims and volumes only if requested. Closes the connection."""
    with interruptible() as cancel:
        return take_down(found, settings, report, cancel, volumes=volumes)


def take_down(
    found: Release,
    settings: Settings,
    report: Reporter,
    cancel: threading.Event,
    *,
    volumes: bool,
) -> Plan:
    """Delete a release that is connected, whose connection is then closed."""
    with found.cluster as cluster:
        cluster.endure(report.line, cancel)
        options = DeployOptions.of(settings, report, cancel)
        return removal.down(cluster, found.id, options, volumes=volumes)
