"""A deploy's own revision: pending when it begins, then good, failed or interrupted.

The pending one names old and new objects together: after an interruption the next deploy finds all
that may be left in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timezone

import attrs

from rigel_k8s import __version__
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.release import locking as lease
from rigel_k8s.release import revisions
from rigel_k8s.release.part import Look, Run
from rigel_k8s.release.survey import namespace_ref
from rigel_k8s.release.types import InventoryItem, Plan, Revision


def make_revision(run: Run, seen: Look) -> Revision:
    """Return the pending revision: its inventory is what was there and what will be."""
    found, back_to = seen.survey, run.part.back_to
    namespace = namespace_ref(run.release)
    known = {item.ref: item.uid for item in found.inventory}
    for step in seen.plan.steps:
        if step.ref != namespace:
            known[step.ref] = str(step.live["metadata"]["uid"]) if step.live else ""
    source = next((record.source for record in found.history if record.number == back_to), "")
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
        back_to=back_to,
        by=lease.name_user(),
        source=run.desired.source or source,
    )


def begin(run: Run, seen: Look) -> tuple[Revision, Sequence[revisions.Record]]:
    """Write the pending revision; return it and the earlier ones that are kept."""
    pending = make_revision(run, seen)
    kept = revisions.forget_unfinished(run.cluster, seen.survey.history, run.part.back_to)
    revisions.create(run.cluster, pending)
    return pending, kept


def add_uids(pending: Revision, applied: Mapping[ObjectRef, Manifest]) -> Revision:
    """Return a revision that knows which objects were made."""
    made = {ref: str(live["metadata"]["uid"]) for ref, live in applied.items()}
    inventory = [InventoryItem(i.ref, made.get(i.ref, i.uid)) for i in pending.inventory]
    return attrs.evolve(pending, inventory=tuple(inventory))


def mark_ended(run: Run, pending: Revision, error: RigelK8sError) -> None:
    """Mark a revision failed, or interrupted: the cluster may complete it."""
    details = [line for line in error.details[:1] if not line.startswith(" ")]  # no line of a log
    why = "; ".join([error.message, *details])
    ended = attrs.evolve(pending, status="failed", failure=why)
    if error.exit_code == 130:
        ended = attrs.evolve(pending, status="interrupted")
    with suppress(ClusterError):  # the first error matters more
        revisions.update(run.cluster, ended)


def mark_good(
    run: Run, pending: Revision, plan: Plan, kept: Sequence[revisions.Record]
) -> Revision:
    """Mark a revision good, close what killed deploys left open, and forget the oldest ones."""
    there = {step.ref for step in plan.steps if step.action in ("create", "change", "keep")}
    mine = tuple(item for item in pending.inventory if item.ref in there and item.uid)
    good = attrs.evolve(pending, status="good", inventory=mine)
    revisions.update(run.cluster, good)
    for record in kept:
        if record.status == "pending":
            revisions.update(run.cluster, attrs.evolve(record.revision(), status="interrupted"))
    revisions.forget_old(run.cluster, [*kept, revisions.record(good)])
    return good
