"""The observability stack as a part of a job; nothing is written if nothing changed.

Several applications share one stack, so the options of one are merged over those of others: one
with only `enabled: true` must not revert the retention or images that another has set.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.facts import is_default_class, is_ready
from rigel_k8s.objects.overlay import merge, pod_of
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.observability.checks import check
from rigel_k8s.observability.names import NAMESPACE, RELEASE
from rigel_k8s.observability.options import ObservabilityOptions, StackRequest
from rigel_k8s.observability.reading.stack import find_namespace
from rigel_k8s.pinning import pin
from rigel_k8s.release.apply import make_namespace
from rigel_k8s.release.part import Hooks, Inspection, Look, Part, Run, if_allowed
from rigel_k8s.release.revisions import find_last_good
from rigel_k8s.release.types import Desired, ReleaseId, Revision
from rigel_k8s.report import Reporter
from rigel_k8s.rigelfile.structure import InvalidOptions, structure_plain
from rigel_stack import boards
from rigel_stack.manifests.desired import stack_release
from rigel_stack.manifests.scraping import GROUP_VERSION, KINDS
from rigel_stack.manifests.stack import Boards, Stack
from rigel_stack.password import administrator_ref, ensure_administrator

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


@attrs.frozen
class DesiredStack:
    """The desired stack of a cluster."""

    stack: Stack
    desired: Desired

    @property
    def release(self) -> ReleaseId:
        """The stack's release."""
        return self.desired.release


def render_stack(request: StackRequest, namespace: str | None = None) -> DesiredStack:
    """Return the stack as one job alone describes it; no cluster is asked."""
    where = namespace or request.namespace or NAMESPACE
    stack = Stack(_structure(request.options), where, Boards(boards.dashboards(), boards.rules()))
    return DesiredStack(stack, stack_release(stack, request.options))


def desired_stack(request: StackRequest, cluster: Cluster) -> DesiredStack:
    """Return the desired stack of a cluster.

    Raises:
        UserError: there is one in another namespace, or all options together contradict each other.
    """
    where = _choose_namespace(request.namespace, find_namespace(cluster))
    last = find_last_good(cluster, ReleaseId(where, RELEASE))
    merged = merge(dict(last.options) if last else {}, request.options)
    stack = Stack(
        _structure(merged),
        where,
        Boards(boards.dashboards(), boards.rules()),
        claims=gives_storage(cluster),
        api_servers=api_servers(cluster),
    )
    made = stack_release(stack, merged)
    keep_positions(made.objects, last.objects if last else (), cluster)
    made = pin(made, last, cluster.nodes)
    beside = [administrator_ref(where)] if stack.has_grafana else []
    return DesiredStack(stack, attrs.evolve(made, beside=frozenset(beside)))


def _choose_namespace(requested: str | None, existing: str | None) -> str:
    if existing and requested and requested != existing:
        raise UserError(
            f"the cluster already has an observability stack in the namespace {existing}, and all"
            " applications share one",
            hint=f"set observability.namespace to {existing}, remove it, or take that stack down"
            " first",
        )
    return existing or requested or NAMESPACE


def _structure(merged: Mapping[str, Any]) -> ObservabilityOptions:
    """Return the options of all jobs together."""
    try:
        return structure_plain(merged, ObservabilityOptions, check)
    except InvalidOptions as error:
        raise UserError(
            "the options of this job contradict those of earlier ones for the observability stack",
            hint="several applications share one stack, so their options are merged: change them",
            details=list(map(str, error.problems)),
        ) from error


def gives_storage(cluster: Cluster) -> bool:
    """Return whether a claim that names no StorageClass gets a volume."""
    classes = cluster.list("storage.k8s.io/v1", "StorageClass")
    return any(is_default_class(one) for one in classes)


def keep_positions(made: Iterable[Manifest], last: Iterable[Manifest], cluster: Cluster) -> None:
    """Let collectors store their position where they did before, or in their cluster's directory.

    Machines of two clusters may share a disk; the UID of kube-system differs in both.
    """
    before = {name: there["path"] for name, there in find_positions(last)}
    for name, there in find_positions(made):
        if name in before:
            there["path"] = before[name]
        elif space := cluster.get(ObjectRef("v1", "Namespace", "", "kube-system")):
            there["path"] += f"/{space['metadata']['uid'][:8]}"


def find_positions(objects: Iterable[Manifest]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the names of collectors, and the path on machines at which each has its position."""
    for made in objects:
        for volume in pod_of(made).get("volumes") or ():
            if volume["name"] == "positions":
                yield made["metadata"]["name"], volume["hostPath"]


def api_servers(cluster: Cluster) -> tuple[str, ...]:
    """Return the addresses that the API servers' connections to pods come from.

    On the way to another machine, a tunnel may replace the address by its own: flannel uses the
    first one of the machine's pods.
    """
    slices = cluster.list(
        "discovery.k8s.io/v1",
        "EndpointSlice",
        "default",
        labels={"kubernetes.io/service-name": "kubernetes"},
    )
    found = {address for one in slices for end in one["endpoints"] for address in end["addresses"]}
    for node in cluster.nodes():
        own = {entry["address"] for entry in node.get("status", {}).get("addresses", [])}
        if found & own and (range_ := node["spec"].get("podCIDR")):
            found = found | {str(range_).partition("/")[0]}
    return tuple(sorted(found))


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
