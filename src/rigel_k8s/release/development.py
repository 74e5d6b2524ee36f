"""A Deployment of a release that differs from its revision for a while, and its way back.

Both changes are server-side applies of all that is ours, so the next apply of the revision removes
what is left of a process that was killed in between. The Lease is held for each of the two alone.

A restart, new pods of workloads that stay as they are, is here as well.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RESTARTED_ANNOTATION, find_development
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release import revisions
from rigel_k8s.release.apply import Applier
from rigel_k8s.release.labelling import add_hash, hash_of
from rigel_k8s.release.locking import PROCESS, Held, hold, is_alive, process
from rigel_k8s.release.part import Run
from rigel_k8s.release.rollout.wait import wait
from rigel_k8s.release.types import DeployOptions, ReleaseId, Revision, Step

RUN_FIRST = "`rigel run` puts the release's version back"


@contextmanager
def changed(
    cluster: Cluster,
    release: ReleaseId,
    ref: ObjectRef,
    note: str,
    change: Callable[[Manifest], Manifest],
    options: DeployOptions,
) -> Iterator[None]:
    """Have a changed form of a Deployment, and the release's in the end.

    Args:
        note: what is developed, by whom, and since when; `change` writes it, too.

    Raises: as begin and end.
    """
    begin(cluster, release, ref, change, options)
    try:
        yield
    finally:
        options.report.line(f"{ref.name} gets the release's version again")
        end(cluster, release, ref, note, options)


def begin(
    cluster: Cluster,
    release: ReleaseId,
    ref: ObjectRef,
    change: Callable[[Manifest], Manifest],
    options: DeployOptions,
) -> None:
    """Apply a changed form of a Deployment of the last revision; do not wait for its pod.

    Raises:
        UserError: another process develops it, or it is not as the last revision describes it.
        ConflictError: other managers own fields of it.
        ClusterError: the cluster refused, does not answer, or a deploy is in progress.
    """
    with hold(cluster, release, options) as lease:
        revision, manifest = find_manifest(cluster, release, ref)
        live = cluster.get(ref)
        if note := find_development(live):
            if live is not None and is_alive(live) is not False:
                raise UserError(note, hint=RUN_FIRST)
        elif live is None or hash_of(live) != hash_of(manifest):
            raise UserError(
                f"{ref} is not as revision {revision.number} describes it", hint=RUN_FIRST
            )
        changed = dict(change(manifest))
        meta = changed["metadata"]
        own = {**meta["annotations"], PROCESS: process()}
        changed = add_hash({**changed, "metadata": {**meta, "annotations": own}})
        run = Run.of_objects(cluster, release, options, changed)
        write(run, lease, changed, live)


def end(
    cluster: Cluster, release: ReleaseId, ref: ObjectRef, note: str, options: DeployOptions
) -> None:
    """Apply a Deployment of the last revision again, and wait until its pods are ready.

    Its pods are replaced one by one, whatever its strategy: the one that was developed does not
    hand over. It is left alone if another process has changed it, and so its note.

    Raises: as begin, and RolloutFailed.
    """
    # What interrupts the work begins its end.
    options = attrs.evolve(options, cancel=threading.Event())
    cluster.endure(options.report.line, options.cancel)
    with hold(cluster, release, options) as lease:
        live = cluster.get(ref)
        if find_development(live) != note:
            return
        _, manifest = find_manifest(cluster, release, ref)
        spec = {**manifest["spec"], "strategy": {"type": "Recreate"}}
        one_by_one = add_hash({**manifest, "spec": spec})
        run = Run.of_objects(cluster, release, options, one_by_one)
        good = revisions.find_good(revisions.records(cluster, release))
        replaced = write(run, lease, one_by_one, live)
        try:
            wait(run, [replaced], good, lease.check)
        finally:
            write(run, lease, manifest, replaced)


def write(run: Run, lease: Held, manifest: Manifest, live: Manifest | None) -> Manifest:
    """Apply a manifest onto what was read."""
    step = Step("change", ref_of(manifest), manifest, live)
    return Applier(run, confirm=lease.confirm).write(step)


def find_manifest(
    cluster: Cluster, release: ReleaseId, ref: ObjectRef
) -> tuple[Revision, Manifest]:
    """Return the last revision and an object of it; UserError if it has none."""
    for record in revisions.records(cluster, release)[-1:]:
        revision = record.revision()
        for manifest in revision.objects:
            if ref_of(manifest) == ref:
                return revision, manifest
    raise UserError(f"no revision of {release.name} has {ref}", hint="deploy it with `rigel run`")


def restart(
    cluster: Cluster, release: ReleaseId, workloads: Iterable[ObjectRef], options: DeployOptions
) -> None:
    """Replace the pods of some workloads of a release, each as in an update; wait for them.

    A Job is made again, and so runs again. The note that restarts others stays in a deploy, which
    therefore does not restart them again.

    Raises:
        RolloutFailed: a new pod does not become ready.
        Interrupted: `options.cancel` was set.
        ClusterError: the cluster refused, does not answer, or a deploy is in progress.
    """
    when = datetime.now(timezone.utc).isoformat(timespec="seconds")
    noted = {"spec": {"template": {"metadata": {"annotations": {RESTARTED_ANNOTATION: when}}}}}
    with hold(cluster, release, options) as lease:
        changed = []
        for ref in workloads:
            lease.confirm()
            if ref.kind == "Job":
                _, job = find_manifest(cluster, release, ref)
                run = Run.of_objects(cluster, release, options, job)
                step = Step("change", ref, job, cluster.get(ref), replaces=True)
                changed.append(Applier(run, confirm=lease.confirm).write(step))
                continue
            changed.append(cluster.patch(ref, noted))
        run = Run.of_objects(cluster, release, options, *changed)
        wait(run, changed, revisions.find_good(revisions.records(cluster, release)), lease.check)
