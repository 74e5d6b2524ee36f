"""status: what of a release runs where.

It is called often, also by scripts: it imports nothing that only deploying needs.
"""

from __future__ import annotations

import attrs

from rigel_k8s.commands.targets import release
from rigel_k8s.graph.check import survey
from rigel_k8s.graph.findings import DiscoveryGraph
from rigel_k8s.release.status import ReleaseStatus
from rigel_k8s.release.status import status as read_status
from rigel_k8s.rosgraph.gate import GateStatus, read_gate
from rigel_k8s.settings import Settings


@attrs.frozen
class Status:
    """What of a release runs where.

    Attributes:
        graph: who discovers whom; None without DDS, or where nobody asked.
        gate: what the gate in front of roscore knows; None without one, or where nobody asked.
    """

    release: ReleaseStatus
    graph: DiscoveryGraph | None = None
    gate: GateStatus | None = None

    @property
    def ok(self) -> bool:
        """Whether all that is needed is ready, and no node is kept from the others."""
        ready = all(workload.ok for workload in self.release.workloads)
        return ready and not (self.graph and self.graph.errors)


def status(settings: Settings, job: str | None, *, graph: bool = True) -> Status:
    """Return what of a release runs where.

    Args:
        graph: look from inside its pods whether DDS nodes discover each other, and what roscore's
            gate knows; takes seconds.

    Raises:
        UserError: nothing of it is on the cluster.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        state = read_status(cluster, found.id)
        if not graph:
            return Status(state)
        return Status(state, survey(cluster, found.id), read_gate(cluster, found.id))
