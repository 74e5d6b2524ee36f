"""Installs the stack on a cluster, or updates it; writes nothing if nothing changed."""

from __future__ import annotations

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.desired import DesiredStack, desired_stack
from rigel_k8s.observability.manifests.operator import GROUP_VERSION, KINDS
from rigel_k8s.observability.password import ensure_administrator
from rigel_k8s.observability.request import StackRequest
from rigel_k8s.release.deploy import deploy, diff, find_last_good
from rigel_k8s.release.locking import bury_left
from rigel_k8s.release.types import DeployOptions, ReleaseId, Revision
from rigel_k8s.report import Reporter

#: Seconds in which a machine can pull all images of the stack.
PATIENT = 600.0


@attrs.frozen
class StackResult:
    """The result of an installation.

    Attributes:
        changed: whether anything was written.
        away: machines that are unreachable and were not waited for.
    """

    stack: DesiredStack
    revision: Revision
    changed: bool
    away: tuple[str, ...] = ()


def ensure(cluster: Cluster, request: StackRequest, options: DeployOptions) -> None:
    """Install the stack that an application's job requests.

    With rights only for applications, it prints a warning and leaves the stack unchanged.

    Raises: as install.
    """
    try:
        done = install(cluster, request, options)
    except Forbidden as error:
        options.report.warn(
            f"{error.message}: the observability stack stays unchanged; {error.hint}"
        )
        return
    if done.changed:
        options.report.line(describe(done))


def install(cluster: Cluster, request: StackRequest, options: DeployOptions) -> StackResult:
    """Install the stack, or update it, and wait until it is ready.

    Raises:
        UserError: its options contradict those of others, or its operator is not installed.
        RolloutFailed, ConflictError, Refused: as in deploy.
        Forbidden: we have no right to do it.
        Interrupted: the job was cancelled.
    """
    try:
        asked = desired_stack(request, cluster)
        _check_operator(asked, cluster)
        return _install(asked, cluster, options, request.password)
    except Forbidden as error:
        error.hint = "let an administrator install it once for all with a job `observability`"
        raise


def describe(done: StackResult) -> str:
    """Return the result in one line."""
    release = done.stack.release
    away = f"; not waited for, since unreachable: {', '.join(done.away)}" if done.away else ""
    state = f"is at revision {done.revision.number}" if done.changed else "is unchanged"
    return f"{release.name} in {release.namespace} {state}{away}"


def _check_operator(asked: DesiredStack, cluster: Cluster) -> None:
    """Raise an error if the cluster does not have the operator's kinds."""
    if asked.stack.operator is None:
        return
    missing = [kind for kind in KINDS if not cluster.serves(GROUP_VERSION, kind)]
    if missing:
        raise UserError(
            f"observability.existing.prometheus: the cluster has no kind {' and no '.join(missing)}"
            f" ({GROUP_VERSION}), so prometheus-operator is not installed",
            hint="install the operator first, or remove existing.prometheus to deploy a Prometheus"
            " with the stack",
        )


def _install(
    asked: DesiredStack, cluster: Cluster, options: DeployOptions, password: str | None
) -> StackResult:
    _warn_of_lost_data(asked, options.report)
    last = find_last_good(cluster, asked.release)
    plan = diff(asked.desired, cluster, adopt=options.adopt)
    if asked.stack.has_grafana:
        _make_namespace(cluster, asked.release)
        ensure_administrator(cluster, asked.release.namespace, password)
    if last is not None and not plan.changes and last.options == asked.desired.options:
        bury_left(cluster, asked.release, options.report)
        return StackResult(asked, last, changed=False)
    away = tuple(n["metadata"]["name"] for n in cluster.nodes() if not is_ready(n))
    for name in away:
        options.report.warn(f"machine {name} is not ready: the installation does not wait for it")
    revision = deploy(
        asked.desired,
        cluster,
        attrs.evolve(options, timeout=options.timeout or PATIENT),
        away=away,
    )
    return StackResult(asked, revision, changed=True, away=away)


def _make_namespace(cluster: Cluster, release: ReleaseId) -> None:
    ref = ObjectRef("v1", "Namespace", "", release.namespace)
    if cluster.get(ref) is None:
        cluster.apply({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": ref.name}})


def _warn_of_lost_data(asked: DesiredStack, report: Reporter) -> None:
    """Warn that data are deleted with their pod, unless the options request that."""
    stack = asked.stack
    if stack.claims:
        return
    for name, ours, persistence in (
        ("loki", stack.has_loki, stack.options.loki.persistence),
        ("prometheus", stack.has_prometheus, stack.options.prometheus.persistence),
    ):
        if ours and persistence.enabled is None and persistence.storage_class is None:
            report.warn(
                f"{name} loses its data when its pod is deleted: the cluster has no default"
                f" StorageClass; set {name}.persistence.storage_class, or"
                f" {name}.persistence.enabled: false"
            )
