"""What the stack shall be: what one application says of it, laid over what others have said.

Several applications share one stack, so that one that says `enabled: true` must not take back what
another has said of retention or images.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.overlay import merge
from rigel_k8s.observability import boards
from rigel_k8s.observability.checks import check
from rigel_k8s.observability.installation import api_servers, find_namespace, gives_storage
from rigel_k8s.observability.manifests.desired import stack_release
from rigel_k8s.observability.manifests.stack import Boards, Stack
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.observability.options import ObservabilityOptions
from rigel_k8s.observability.request import StackRequest
from rigel_k8s.pinning import pin
from rigel_k8s.release.deploy import find_last_good
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.rigelfile.structure import InvalidOptions, structure_plain

NAMESPACE = "monitoring"


@attrs.frozen
class DesiredStack:
    """The stack of a cluster as it is to be."""

    stack: Stack
    desired: Desired

    @property
    def release(self) -> ReleaseId:
        """The stack's release."""
        return self.desired.release


def render_stack(request: StackRequest, namespace: str | None = None) -> DesiredStack:
    """Return the stack as one job alone describes it; no cluster is asked."""
    where = namespace or request.namespace or NAMESPACE
    stack = Stack(_options(request.said), where, Boards(boards.dashboards(), boards.rules()))
    return DesiredStack(stack, stack_release(stack, request.said))


def desired_stack(request: StackRequest, cluster: Cluster) -> DesiredStack:
    """Return the stack as it is to be on a cluster.

    Raises:
        UserError: there is one in another namespace, or what all say together contradicts itself.
    """
    where = _namespace(request.namespace, find_namespace(cluster))
    last = find_last_good(cluster, ReleaseId(where, RELEASE))
    said = merge(dict(last.options) if last else {}, request.said)
    stack = Stack(
        _options(said),
        where,
        Boards(boards.dashboards(), boards.rules()),
        claims=gives_storage(cluster),
        api_servers=api_servers(cluster),
    )
    return DesiredStack(stack, pin(stack_release(stack, said), last, cluster.nodes))


def _namespace(asked: str | None, there: str | None) -> str:
    if there and asked and asked != there:
        raise UserError(
            f"the cluster has an observability stack in the namespace {there} already, and all"
            " applications share one",
            hint=f"say observability.namespace: {there}, leave it out, or take that one down first",
        )
    return there or asked or NAMESPACE


def _options(said: Mapping[str, Any]) -> ObservabilityOptions:
    """Return what all jobs say together as options."""
    try:
        return structure_plain(said, ObservabilityOptions, check)
    except InvalidOptions as error:
        raise UserError(
            "the observability stack cannot be what this job and those before it say",
            hint="several applications share one stack: their options are laid over each other",
            details=list(map(str, error.problems)),
        ) from error
