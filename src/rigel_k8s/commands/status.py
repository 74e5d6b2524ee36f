"""status and list: what runs where, for one release or all of them.

Scripts call it often, so it imports nothing that only a deploy needs.
"""

from __future__ import annotations

import attrs

from rigel_k8s.commands.targets import release
from rigel_k8s.discovery.check import survey
from rigel_k8s.discovery.findings import DiscoveryGraph
from rigel_k8s.kube import connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.release.listing import ReleaseSummary, list_releases
from rigel_k8s.release.status import ReleaseStatus
from rigel_k8s.release.status import status as read_status
from rigel_k8s.rosgraph.handover import GateStatus, read_gate
from rigel_k8s.settings import Settings


@attrs.frozen
class Status:
    """What runs where, for one release.

    Attributes:
        graph: which nodes discover each other; None without DDS, or if not requested.
        gate: the state of roscore's gate; None without one, or if not requested.
    """

    release: ReleaseStatus
    graph: DiscoveryGraph | None = None
    gate: GateStatus | None = None

    @property
    def ok(self) -> bool:
        """Whether everything required is ready, and all nodes reach the others."""
        ready = all(workload.ok for workload in self.release.workloads)
        return ready and not (self.graph and self.graph.errors)


def status(settings: Settings, job: str | None, *, graph: bool = True) -> Status:
    """Return what runs where, for one release.

    Args:
        graph: check from inside its pods whether DDS nodes discover each other, and read the state
            of roscore's gate; takes seconds.

    Raises:
        UserError: the cluster has nothing of it.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        state = read_status(cluster, found.id)
        if not graph:
            return Status(state)
        return Status(state, survey(cluster, found.id), read_gate(cluster, found.id))


def releases(settings: Settings, *, everywhere: bool) -> tuple[str | None, list[ReleaseSummary]]:
    """Return the listed namespace, None for all, and its releases.

    Raises:
        Forbidden: the right to list Secrets or workloads is missing.
    """
    with connect(settings) as cluster:
        namespace = None if everywhere else settings.namespace or cluster.namespace
        try:
            return namespace, list_releases(cluster, namespace)
        except Forbidden as error:
            if everywhere:
                error.hint = "list one namespace only with `rigel list -n NAMESPACE`, without -A"
            raise
