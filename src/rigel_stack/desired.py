"""The desired stack: the options of one application, merged over those of others.

Several applications share one stack, so one with only `enabled: true` must not revert the retention
or images that another has set.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.facts import is_default_class
from rigel_k8s.objects.overlay import merge, pod_of
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.observability.checks import check
from rigel_k8s.observability.names import NAMESPACE, RELEASE
from rigel_k8s.observability.options import ObservabilityOptions, StackRequest
from rigel_k8s.observability.reading.stack import find_namespace
from rigel_k8s.pinning import pin
from rigel_k8s.release.revisions import find_last_good
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.rigelfile.structure import InvalidOptions, structure_plain
from rigel_stack import boards
from rigel_stack.manifests.desired import stack_release
from rigel_stack.manifests.stack import Boards, Stack
from rigel_stack.password import administrator_ref


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
    stack = Stack(_options(request.options), where, Boards(boards.dashboards(), boards.rules()))
    return DesiredStack(stack, stack_release(stack, request.options))


def desired_stack(request: StackRequest, cluster: Cluster) -> DesiredStack:
    """Return the desired stack of a cluster.

    Raises:
        UserError: there is one in another namespace, or all options together contradict each other.
    """
    where = _namespace(request.namespace, find_namespace(cluster))
    last = find_last_good(cluster, ReleaseId(where, RELEASE))
    merged = merge(dict(last.options) if last else {}, request.options)
    stack = Stack(
        _options(merged),
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


def _namespace(requested: str | None, existing: str | None) -> str:
    if existing and requested and requested != existing:
        raise UserError(
            f"the cluster already has an observability stack in the namespace {existing}, and all"
            " applications share one",
            hint=f"set observability.namespace to {existing}, remove it, or take that stack down"
            " first",
        )
    return existing or requested or NAMESPACE


def _options(merged: Mapping[str, Any]) -> ObservabilityOptions:
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
