"""The observability stack as a part of a job; nothing is written if nothing changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.observability.options import StackRequest
from rigel_k8s.release.apply import make_namespace
from rigel_k8s.release.part import Hooks, Inspection, Look, Part, Run, if_allowed
from rigel_k8s.release.types import Revision
from rigel_k8s.report import Reporter
from rigel_stack.desired import desired_stack, render_stack
from rigel_stack.manifests.scraping import GROUP_VERSION, KINDS
from rigel_stack.manifests.stack import Stack
from rigel_stack.password import ensure_administrator

#: Seconds in which a machine can pull all images of the stack.
PATIENT = 600.0
HINT = "let an administrator install it once for all with a job `observability`"


@attrs.frozen(kw_only=True)
class StackHooks(Hooks):
    """Around the stack: its operator and its data before, Grafana's password."""

    stack: Stack
    own: bool
    password: str | None = attrs.field(default=None, repr=False)

    def inspect(self, cluster: Cluster, earlier: Sequence[Look]) -> Inspection:
        """Return that its operator is not installed, and which data will be lost."""
        errors = () if self.stack.operator is None else tuple(find_missing_operator(cluster))
        return Inspection(errors, tuple(warn_of_lost_data(self.stack)))

    def before_write(self, run: Run, seen: Look) -> None:
        """Create Grafana's administrator, whom it needs before it starts."""
        if self.stack.has_grafana:
            make_namespace(run.cluster, run.release.namespace)
            ensure_administrator(run.cluster, run.release.namespace, self.password)

    def after_write(self, run: Run, revision: Revision | None, seen: Look) -> None:
        away = ", ".join(run.part.away)
        if seen.writes and revision is not None:
            left = f"; not waited for, since unreachable: {away}" if away else ""
            run.report.line(f"{run.where} is at revision {revision.number}{left}")
        elif self.own:
            run.report.line(f"{run.where} is unchanged")


def stack_part(request: StackRequest, cluster: Cluster | None, *, own: bool = True) -> Part:
    """Return the stack as a job requests it, merged into what others have requested.

    Args:
        cluster: None: as the job alone describes it.
        own: the job is about nothing else.

    Raises:
        UserError: its options contradict those of others.
        Forbidden: we may not look at it.
    """
    if cluster is None:
        asked, away = render_stack(request), ()
    else:
        try:
            asked = desired_stack(request, cluster)
            nodes = cluster.nodes()
        except Forbidden as error:
            error.hint = HINT
            raise
        away = tuple(node["metadata"]["name"] for node in nodes if not is_ready(node))
    return Part(
        desired=asked.desired,
        rank="stack",
        own=own,
        needed=own,
        shared=True,
        hint=HINT,
        away=away,
        timeout=PATIENT,
        hooks=StackHooks(stack=asked.stack, own=own, password=request.password),
    )


def requested_stack(request: StackRequest, cluster: Cluster | None, report: Reporter) -> list[Part]:
    """Return the stack that an application's job requests.

    With rights only for applications it is left as it is, with a warning.
    """
    return if_allowed(lambda: stack_part(request, cluster, own=False), RELEASE, report)


def find_missing_operator(cluster: Cluster) -> Iterator[UserError]:
    """Yield an error if the cluster does not have the operator's kinds."""
    missing = [kind for kind in KINDS if not cluster.serves(GROUP_VERSION, kind)]
    if missing:
        yield UserError(
            f"observability.existing.prometheus: the cluster has no kind {' and no '.join(missing)}"
            f" ({GROUP_VERSION}), so prometheus-operator is not installed",
            hint="install the operator first, or remove existing.prometheus to deploy a Prometheus"
            " with the stack",
        )


def warn_of_lost_data(stack: Stack) -> Iterator[str]:
    """Yield warnings that data are deleted with their pod, unless the options request that."""
    if stack.claims:
        return
    for name, ours, persistence in (
        ("loki", stack.has_loki, stack.options.loki.persistence),
        ("prometheus", stack.has_prometheus, stack.options.prometheus.persistence),
    ):
        if ours and persistence.enabled is None and persistence.storage_class is None:
            yield (
                f"{name} loses its data when its pod is deleted: the cluster has no default"
                f" StorageClass; set {name}.persistence.storage_class, or"
                f" {name}.persistence.enabled: false"
            )
