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
from rigel_k8s.objects.overlay import merge, plain
from rigel_k8s.observability import boards
from rigel_k8s.observability.checks import check
from rigel_k8s.observability.installation import api_servers, gives_storage, installed_in
from rigel_k8s.observability.manifests.desired import stack_release
from rigel_k8s.observability.manifests.stack import Boards, Stack
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.observability.options import ObservabilityOptions
from rigel_k8s.release.deploy import last_good
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.rigelfile.source import Node, Span, made
from rigel_k8s.rigelfile.structure import structure

__all__ = ["NAMESPACE", "Wanted", "rendered", "shared", "wanted"]

NAMESPACE = "monitoring"
#: What is one application's own, or where the stack is and not what it is.
OWN = ("enabled", "ros_metrics", "namespace")


@attrs.frozen
class Wanted:
    """The stack of a cluster as it shall be.

    Attributes:
        before: whether a stack was there.
    """

    stack: Stack
    desired: Desired
    before: bool = False

    @property
    def release(self) -> ReleaseId:
        """The stack's release."""
        return self.desired.release


def shared(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a job's `observability` says of the stack itself, without any password."""
    said: dict[str, Any] = {key: v for key, v in plain(raw).items() if key not in OWN}
    grafana = said.get("grafana")
    if isinstance(grafana, dict):
        said["grafana"] = {key: v for key, v in grafana.items() if key != "admin_password"}
    return said


def rendered(raw: Mapping[str, Any], namespace: str | None = None) -> Wanted:
    """Return the stack as this job alone describes it; no cluster is asked."""
    said = shared(raw)
    where = namespace or str(raw.get("namespace") or NAMESPACE)
    stack = Stack(_options(said), where, Boards(boards.dashboards(), boards.rules()))
    return Wanted(stack, stack_release(stack, said))


def wanted(raw: Mapping[str, Any], cluster: Cluster) -> Wanted:
    """Return the stack as it shall be on a cluster.

    Args:
        raw: a job's `observability` as plain data.

    Raises:
        UserError: there is one in another namespace, or what all say together contradicts itself.
    """
    there = installed_in(cluster)
    where = _namespace(raw, there)
    last = last_good(cluster, ReleaseId(where, RELEASE))
    said = merge(dict(last.options) if last else {}, shared(raw))
    stack = Stack(
        _options(said),
        where,
        Boards(boards.dashboards(), boards.rules()),
        claims=gives_storage(cluster),
        api_servers=api_servers(cluster),
    )
    return Wanted(stack, stack_release(stack, said), before=last is not None)


def _namespace(raw: Mapping[str, Any], there: str | None) -> str:
    said = raw.get("namespace")
    if there and said and said != there:
        raise UserError(
            f"the cluster has an observability stack in the namespace {there} already, and all"
            " applications share one",
            hint=f"say observability.namespace: {there}, leave it out, or take that one down first",
        )
    return str(there or said or NAMESPACE)


def _options(said: Mapping[str, Any]) -> ObservabilityOptions:
    """Return plain data as options."""
    found = structure(made(dict(said), Node({}, Span(1, 1, 1, 1))), ObservabilityOptions)
    problems = list(found.problems)
    if found.draft is not None and not problems:
        problems = [p for p in check(found.draft) if p.severity == "error"]
    if found.draft is None or problems:
        raise UserError(
            "the observability stack cannot be what this job and those before it say",
            hint="several applications share one stack: their options are laid over each other",
            details=[f"{'.'.join(map(str, p.path))}: {p.message} [{p.kind}]" for p in problems],
        )
    options: ObservabilityOptions = found.draft
    return options
