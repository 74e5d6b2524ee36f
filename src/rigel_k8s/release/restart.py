"""New pods of workloads that stay as they are, as by `kubectl rollout restart`."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime, timezone

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RESTARTED_ANNOTATION
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import revisions
from rigel_k8s.release.apply import Applier
from rigel_k8s.release.development import find_manifest
from rigel_k8s.release.locking import hold
from rigel_k8s.release.part import Run
from rigel_k8s.release.rollout.wait import wait
from rigel_k8s.release.types import DeployOptions, ReleaseId, Step


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
