"""What a deploy is, from first to last.

    read       a Rigelfile becomes the options of a job: rigelfile/, app/checks/
    describe   the job's type makes parts of them: releases as they should be (app/desired.py)
    look       at the cluster, for all parts: what is there, what would be done (release/look.py)
    refuse     all that cannot work, at once, before anything is written (release/refusals/)
    apply      each part's objects, in the order network, application, stack (release/apply.py)
    wait       until all is ready, or the cause why not is known (release/rollout/)
    record     a revision to roll back to (release/record.py)
    watch      the running robot (the hooks of each part: release/part.py)

`rigel check` ends after the first of them, `render` after the second, `diff` after `refuse`; `run`
does all. A rollback is the same, from an earlier revision's objects; `down` applies nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import attrs

from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release import locking, record, removal, revisions, rollback
from rigel_k8s.release.apply import Applier, make_namespace
from rigel_k8s.release.labelling import manifests_to_apply
from rigel_k8s.release.look import look, look_again, look_at, refuse_or_plan
from rigel_k8s.release.part import Look, Part, Run, order
from rigel_k8s.release.plan import describe_plan, predecessors
from rigel_k8s.release.pulling import pull_images
from rigel_k8s.release.refusals.verdict import warn_of_obstacles
from rigel_k8s.release.rollout.wait import wait, wait_settled
from rigel_k8s.release.types import DeployOptions, Desired, Plan, ReleaseId, Revision


def render(parts: Iterable[Part]) -> tuple[Manifest, ...]:
    """Return the manifests that apply would send."""
    return tuple(item for part in order(parts) for item in manifests_to_apply(part.desired))


def deploy(parts: Iterable[Part], cluster: Cluster, options: DeployOptions) -> None:
    """Deploy all that a job describes.

    Raises:
        RigelK8sError: it would be refused, for these reasons; nothing was written.
        ClusterError, RolloutFailed: something went wrong; the causes are in the details.
        Interrupted: `options.cancel` was set.
    """
    warned: set[str] = set()
    written: list[Run] = []
    changed = False
    for seen in look(parts, cluster, options):
        part, adopt = seen.part, options.adopt and seen.part.adopt
        timeout = part.timeout if options.timeout is None else options.timeout
        own = attrs.evolve(options, adopt=adopt, timeout=timeout)
        run = Run(cluster=cluster, part=part, options=own)
        try:
            if changed:  # an earlier part has changed what was seen
                seen = look_at(part, cluster, adopt=adopt)
            for warning in seen.warnings:
                if warning not in warned:
                    options.report.warn(warning)
            warned.update(seen.warnings)
            write_part(run, seen)
        except Interrupted:
            raise
        except RigelK8sError as error:
            if part.needed:
                raise
            text = f"{error.message}; everything else is deployed"
            options.report.warn("\n".join([text, *error.details]))
        written.append(run)
        changed = changed or seen.writes
    for run in written:
        run.part.hooks.watch(run)


def write_part(run: Run, seen: Look) -> None:
    """Write one part, with what only its builder knows around it; go back if that says so."""
    part, hooks = run.part, run.part.hooks
    if seen.writes or part.own:
        for name in part.away:
            run.report.warn(f"machine {name} is not ready: the installation does not wait for it")
    hooks.before_write(run, seen)
    try:
        revision = None if part.foreign else write_release(run, seen)
    except Interrupted:
        raise
    except RigelK8sError as failure:
        back = hooks.way_back(run, failure)
        if back is None:
            raise
        raise rollback.undo(run, failure, back, roll_back) from failure
    hooks.after_write(run, revision, seen)


def write_release(run: Run, seen: Look | None = None) -> Revision:
    """Make one release as desired, wait until it is ready, and return its revision.

    If nothing has changed and the last revision is good, nothing is written.

    Args:
        seen: a look that is not older than the caller's last write; None: none yet.

    Raises:
        Refused, ConflictError: it cannot be changed to that; nothing was changed.
        RolloutFailed: it was applied and does not become ready.
        Interrupted: `options.cancel` was set.
        ClusterError: the cluster refused, does not answer, or another deploy is in progress.
    """
    cluster, options, hooks = run.cluster, run.options, run.part.hooks
    seen = seen or refuse_or_plan(run.part, cluster, adopt=options.adopt)
    if (last := seen.settled) is not None:
        if seen.survey.lease is not None:
            locking.bury(cluster, seen.survey.lease, run.report)
        return last if run.part.shared else wait_settled(run, seen, last)
    revisions.check_size(record.make_revision(run, seen))
    if seen.survey.namespace is None and run.desired.create_namespace:
        make_namespace(cluster, run.release.namespace)  # the Lease needs a place
    with locking.hold(cluster, run.release, options) as lease:
        seen = look_again(run, seen)
        if (last := seen.settled) is not None:  # another deploy has done it
            return wait_settled(run, seen, last)
        plan, good = seen.plan, revisions.find_good(seen.survey.history)
        lines, warnings = describe_plan(plan, run.part, seen.survey.elsewhere)
        for line in lines:
            run.report.line(line)
        for warning in (*warnings, *warn_of_obstacles(seen.survey)):
            run.report.warn(warning)
        pull_images(run, plan, good, lease.check)
        hooks.before_pods(run, plan)
        lease.confirm()
        pending, kept = record.begin(run, seen)
        until_ready = partial(wait, run, good=good, still_ours=lease.check)
        way_out = f"run the same command again to complete it; {run.choose_way_out(good)}"
        applier = Applier(run, confirm=lease.confirm, until_ready=until_ready, way_out=way_out)
        try:
            applied = applier.apply(plan)
            pending = record.add_uids(pending, applied)
            hooks.stored()
            until_ready(list(applied.values()))
            early = {step.ref for step in predecessors(plan)}
            applier.prune(step for step in plan.steps if step.ref not in early)
            hooks.verify(run)
            lease.confirm()
        except RigelK8sError as error:
            if not lease.lost.is_set():  # otherwise the deploy with the Lease owns the revision
                record.mark_ended(run, pending, error)
            raise
        return record.mark_good(run, pending, plan, kept)


def roll_back(
    cluster: Cluster, release: ReleaseId, number: int | None, options: DeployOptions
) -> Revision:
    """Deploy an older revision's objects again, as a new revision.

    Args:
        number: None for that of an interrupted rollback, else for the last good one before.

    Raises:
        UserError: the revision does not exist.
    """
    target = rollback.choose_target(cluster, release, number, options.report)
    part = Part(
        desired=Desired(release, target.objects, options=target.options),
        back_to=target.number,
        # No revision has the data of Secrets.
        keep=frozenset(item.ref for item in target.inventory if item.ref.kind == "Secret"),
    )
    described = attrs.evolve(options, description=f"rollback to revision {target.number}")
    return write_release(Run(cluster=cluster, part=part, options=described))


def down(cluster: Cluster, release: ReleaseId, options: DeployOptions, *, volumes: bool) -> Plan:
    """Delete a release's objects and its history; its namespace stays.

    Args:
        volumes: also delete claims and volumes, with their data.

    Returns:
        What was deleted and what was left; neither steps nor records if there was nothing.
    """
    records = removal.find_records(cluster, release)
    if not records and not removal.find_objects(cluster, release):
        return Plan(release, ())
    with locking.hold(cluster, release, options) as lease:
        plan = removal.make_plan(cluster, release, records, volumes=volumes)
        applier = Applier(
            Run.of_objects(cluster, release, options),
            confirm=lease.confirm,
            state=f"interrupted while {release.name} was being deleted: some of it is deleted",
            way_out="run the same command again to delete the rest",
        )
        applier.remove(plan)
        lease.confirm()
        revisions.forget(cluster, revisions.records(cluster, release))
    return plan
