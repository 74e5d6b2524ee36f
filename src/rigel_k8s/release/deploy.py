"""A release's life: deploy and history (rollback.py and removal.py have the rest).

Look (survey), refuse what is impossible, take the Lease, pull images, write a *pending* revision
that names old and new objects together, apply, wait, prune, mark the revision good. After an
interruption the next run finds in the pending revision all that may be left, and completes it.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from datetime import datetime, timezone

import attrs

from rigel_k8s import __version__
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.release import lease as leases
from rigel_k8s.release import revisions
from rigel_k8s.release.apply import Applier
from rigel_k8s.release.locking import Held, bury, hold
from rigel_k8s.release.order import WORKLOADS
from rigel_k8s.release.plan import compare, predecessors
from rigel_k8s.release.pulling import pull_images
from rigel_k8s.release.refusals import verdict
from rigel_k8s.release.refusals.admission import warn_of_obstacles
from rigel_k8s.release.rollout.wait import wait
from rigel_k8s.release.run import Run
from rigel_k8s.release.survey import Survey, namespace_ref, survey
from rigel_k8s.release.types import Desired, InventoryItem, Plan, ReleaseId, Revision
from rigel_k8s.release.writing import make_namespace

ATTEMPTS = 3  # looks at the cluster when other deploys end while we wait for the Lease


@attrs.frozen
class Look:
    """What is on the cluster, and what a deploy would do there, which nothing refuses."""

    survey: Survey
    plan: Plan


def look(
    cluster: Cluster, desired: Desired, *, adopt: bool, keep: Collection[ObjectRef] = frozenset()
) -> Look:
    """Return what is on the cluster and what a deploy would do. Raises if it would be refused."""
    found = survey(cluster, desired, adopt=adopt)
    verdict.check(found, adopt=adopt)
    return Look(found, compare(found, keep=keep))


def history(cluster: Cluster, release: ReleaseId) -> list[Revision]:
    """Return a release's revisions, the oldest first."""
    found = [record.revision() for record in revisions.records(cluster, release)]
    good = [revision.number for revision in found if revision.status == "good"]
    return [
        attrs.evolve(revision, status="superseded") if revision.number in good[:-1] else revision
        for revision in found
    ]


def find_last_good(cluster: Cluster, release: ReleaseId) -> Revision | None:
    """Return the newest revision that became ready, None if none did."""
    good = [r for r in revisions.records(cluster, release) if r.status == "good"]
    return good[-1].revision() if good else None


def deploy_release(run: Run, looked: Look | None = None) -> Revision:
    """Make a release as desired, wait until it is ready, and return its revision.

    If nothing has changed and the last revision is good, nothing is written, and neither
    `run.before` nor `run.verify` is called.

    Args:
        looked: a look that is not older than the caller's last write; None: none yet.

    Raises:
        Refused: immutable fields, or objects of another release; nothing was changed.
        ConflictError: other managers' fields or objects; nothing was changed.
        RolloutFailed: it was applied and does not become ready.
        Interrupted: `options.cancel` was set.
        ClusterError: the cluster refused, does not answer, or another deploy is in progress; or an
            image cannot be pulled, and nothing was changed.
    """
    cluster, options = run.cluster, run.options
    looked = looked or look_now(run)
    last = looked.survey.last
    if last is not None and is_settled(looked):
        if looked.survey.lease is not None:
            bury(cluster, looked.survey.lease, run.report)
        return wait_settled(run, looked, last)
    revisions.check_size(new_revision(run, looked))
    if looked.survey.namespace is None and run.desired.create_namespace:
        make_namespace(cluster, run.release.namespace)  # the Lease needs a place
    with hold(cluster, run.release, options) as lease:
        looked = look_again(run, looked)
        last = looked.survey.last
        if last is not None and is_settled(looked):  # another deploy did it meanwhile
            return wait_settled(run, looked, last)
        return apply_and_record(run, looked, lease)


def look_now(run: Run) -> Look:
    """Look at the cluster. Raises if the deploy would be refused."""
    return look(run.cluster, run.desired, adopt=run.options.adopt, keep=run.keep)


def wait_settled(run: Run, looked: Look, last: Revision) -> Revision:
    """Return the last revision, which is as desired, when all of it is ready."""
    if run.applied is not None:
        run.applied()
    live = [step.live for step in looked.plan.steps if step.action == "keep" and step.live]
    wait(run, live, revisions.find_good(looked.survey.history), lambda: None)
    return last


def is_settled(looked: Look) -> bool:
    """Whether the last revision is good and as desired, and the cluster matches it."""
    found = looked.survey
    if found.last is None or found.last.status != "good" or looked.plan.changes:
        return False
    wanted = revisions.choose_recordable(found.manifests)
    before = (found.last.objects, found.last.options)
    return json.dumps(before, sort_keys=True) == json.dumps(
        (wanted, found.desired.options), sort_keys=True
    )


def look_again(run: Run, looked: Look) -> Look:
    """Return what was found; look again if another deploy has ended since."""
    for _ in range(ATTEMPTS):
        newest = revisions.records(run.cluster, run.release)
        if versions(newest) == versions(looked.survey.history):
            return looked
        looked = look_now(run)
    return looked


def versions(records: Collection[revisions.Record]) -> list[str]:
    """Return a value that changes when any record does."""
    return [str(record.secret["metadata"]["resourceVersion"]) for record in records]


def apply_and_record(run: Run, looked: Look, lease: Held) -> Revision:
    """Apply, wait, prune and record, with the Lease held."""
    found, plan = looked.survey, looked.plan
    report_plan(run, plan)
    for line in warn_of_obstacles(found):
        run.report.warn(line)
    good = revisions.find_good(found.history)
    pull_images(run, plan, good, lease.check)
    if run.before is not None:
        run.before(plan)
    pending = new_revision(run, looked)
    lease.confirm()
    kept = revisions.forget_unfinished(run.cluster, found.history, run.back_to)
    revisions.create(run.cluster, pending)

    def until_ready(live: Sequence[Manifest]) -> None:
        wait(run, live, good, lease.check)

    way_out = f"run the same command again to complete it; {run.choose_way_out(good)}"
    applier = Applier(run, confirm=lease.confirm, until_ready=until_ready, way_out=way_out)
    try:
        applied = applier.apply(plan)
        made = {ref: str(live["metadata"]["uid"]) for ref, live in applied.items()}
        inventory = [InventoryItem(i.ref, made.get(i.ref, i.uid)) for i in pending.inventory]
        pending = attrs.evolve(pending, inventory=tuple(inventory))
        if run.applied is not None:
            run.applied()
        until_ready(list(applied.values()))
        early = {step.ref for step in predecessors(plan)}
        applier.prune(step for step in plan.steps if step.ref not in early)
        if run.verify is not None:
            run.verify()
        lease.confirm()
    except RigelK8sError as error:
        if not lease.lost.is_set():  # otherwise the deploy with the Lease owns the revision
            mark_failed(run, pending, error)
        raise
    there = {step.ref for step in plan.steps if step.action in ("create", "change", "keep")}
    mine = tuple(item for item in pending.inventory if item.ref in there and item.uid)
    done = attrs.evolve(pending, status="good", inventory=mine)
    revisions.update(run.cluster, done)
    clean_up(run, kept, done)
    return done


def new_revision(run: Run, looked: Look) -> Revision:
    """Return the pending revision: its inventory is what was there and what will be."""
    found, plan = looked.survey, looked.plan
    namespace = namespace_ref(run.release)
    known = {item.ref: item.uid for item in found.inventory}
    for step in plan.steps:
        if step.ref != namespace:
            known[step.ref] = str(step.live["metadata"]["uid"]) if step.live else ""
    return Revision(
        release=run.release,
        number=found.next_number,
        status="pending",
        created=datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"),
        objects=revisions.choose_recordable(found.manifests),
        inventory=tuple(InventoryItem(ref, uid) for ref, uid in sorted(known.items())),
        options=run.desired.options,
        description=run.options.description,
        tool_version=__version__,
        back_to=run.back_to,
        by=leases.name_user(),
        source=run.desired.source or find_source(found.history, run.back_to),
    )


def find_source(history: Iterable[revisions.Record], number: int | None) -> str:
    """Return from which folder a revision was deployed; "" if it is not known."""
    return next((record.source for record in history if record.number == number), "")


def mark_failed(run: Run, pending: Revision, error: RigelK8sError) -> None:
    """Mark a revision failed; an interrupted one stays pending and can be continued."""
    if error.exit_code == 130:
        return
    details = [line for line in error.details[:1] if not line.startswith(" ")]  # no line of a log
    why = "; ".join([error.message, *details])
    with suppress(ClusterError):  # the first error matters more
        revisions.update(run.cluster, attrs.evolve(pending, status="failed", failure=why))


def clean_up(run: Run, kept: Sequence[revisions.Record], good: Revision) -> None:
    """Close what earlier runs left open, and forget the oldest revisions."""
    for record in kept:
        if record.status == "pending":
            revisions.update(run.cluster, attrs.evolve(record.revision(), status="failed"))
    revisions.forget_old(run.cluster, [*kept, revisions.record(good)])


def report_plan(run: Run, plan: Plan) -> None:
    """Report what will be done, and which data is left where it is."""
    words = {"create": "to create", "change": "to change", "prune": "to delete"}
    counts = [
        f"{sum(1 for step in plan.steps if step.action == action)} {word}"
        for action, word in words.items()
        if any(step.action == action for step in plan.steps)
    ]
    name = f"{run.release.namespace}/{run.release.name}"
    run.report.line(f"{name}: {', '.join(counts) or 'nothing to change'}")
    if lost := [s.ref.name for s in plan.steps if s.action == "prune" and s.ref.kind in WORKLOADS]:
        run.report.line(f"no longer in the Rigelfile, and deleted: {', '.join(lost)}")
    for step in plan.steps:
        if step.action == "forget":
            run.report.warn(
                f"{step.ref} is no longer in the Rigelfile; it holds data, so it is kept "
                f"(kubectl delete {step.ref.kind.lower()} {step.ref.name} removes it)"
            )
    for ref in sorted(run.keep - {step.ref for step in plan.steps}):
        run.report.warn(f"{ref} is missing, and no revision contains it: deploy from the Rigelfile")
