"""The pod of `rigel join` on the cluster, and the node whose place its program takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from rigel_k8s.app.development import NAME, put_to_sleep
from rigel_k8s.commands.pods import pods_of, release_pods
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release import development
from rigel_k8s.release.locking import name_user, timestamp
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.rollout.causes import explain_pod
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter

LOOK = 0.1  # seconds between two looks at a pod that starts or ends


def find_deployment(found: Release, node: str | None) -> Manifest:
    """Return the Deployment of a node, or of the first one that has our scripts.

    Without `node`, one with a ROS name is preferred: others are anonymous, or not of ROS.
    """
    every = pods_of(found, node) if node else [p for p in release_pods(found) if not p.helper]
    pods = every if node else [pod for pod in every if not pod.once]
    for pod in sorted(pods, key=lambda one: not one.ros_name):
        live = found.cluster.get(pod.find_deployment("joined"))
        if pod.scripts and live is not None:
            return live
    what = f"{node} is no node" if node else f"{found.id.name} has no node"
    raise UserError(f"{what} whose network can be joined", hint="see the nodes with `rigel status`")


def remove_ended(found: Release) -> None:
    """Delete pods that a computer has left behind: they have ended by themselves."""
    labels = {NAME_LABEL: NAME, RELEASE_LABEL: found.id.name}
    for pod in found.cluster.list("v1", "Pod", found.id.namespace, labels=labels):
        if pod["status"].get("phase") in ("Succeeded", "Failed"):
            found.cluster.delete(ref_of(pod))


@contextmanager
def running(cluster: Cluster, pod: Manifest, limit: float, report: Reporter) -> Iterator[None]:
    """Create a Pod, wait until it runs, and delete it in the end.

    Raises:
        ClusterError: it is refused, or does not run within `limit` seconds.
    """
    ref = ref_of(pod)
    try:
        cluster.create(pod)
    except Forbidden as error:
        if error.ground != "pod-security":
            raise
        raise ClusterError(
            f"the namespace {ref.namespace} forbids a pod that may send frames (NET_ADMIN)",
            hint="without that, connect single ports with `rigel forward`: of a Foxglove bridge,"
            " or of a zenoh router",
        ) from error
    try:
        deadline = time.monotonic() + limit
        while (live := cluster.get(ref)) is None or live["status"].get("phase") != "Running":
            if live is None or time.monotonic() > deadline:
                causes = [cause.message for cause in explain_pod(live, ())] if live else []
                raise ClusterError(f"{ref} does not run after {limit:g} s", details=causes)
            time.sleep(LOOK)
        yield
    finally:
        try:
            cluster.delete(ref, grace_seconds=0)
        except ClusterError as error:
            report.warn(f"{ref} is left, and ends by itself: {error}")


@contextmanager
def asleep(found: Release, ref: ObjectRef, node: str, options: DeployOptions) -> Iterator[None]:
    """Let a node have no pod; then it has one again, and is ready.

    Raises: as development.changed.
    """
    note = f"{node} is replaced by a program of {name_user()} since {timestamp()}"
    change = partial(put_to_sleep, note=note)
    labels = {NAME_LABEL: ref.name}
    with development.changed(found.cluster, found.id, ref, note, change, options):
        options.report.line(f"{node} stops")
        deadline = time.monotonic() + options.limit
        while list_pods(found.cluster, found.id, labels):
            if time.monotonic() > deadline:
                raise ClusterError(f"{node} has not stopped after {options.limit:g} s")
            time.sleep(LOOK)
        yield
