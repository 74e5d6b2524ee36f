"""status and list: what runs where, for one release or all of them.

Scripts call it often, so it imports nothing that only a deploy needs.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs

from rigel_k8s.app.deploying.guests import StatusAddition, load_guests
from rigel_k8s.commands.targets import list_namespaces, release
from rigel_k8s.kube import connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.release.listing import ReleaseSummary, list_releases
from rigel_k8s.release.status import ReleaseStatus
from rigel_k8s.release.status import status as read_status
from rigel_k8s.settings import Settings


@attrs.frozen
class Status:
    """What runs where, for one release.

    Attributes:
        additions: what guests have seen; none if not requested.
    """

    release: ReleaseStatus
    additions: Sequence[StatusAddition] = ()

    @property
    def ok(self) -> bool:
        """Whether everything required is ready, and no guest has seen an error."""
        return self.release.ok and all(one.ok for one in self.additions)


def status(settings: Settings, job: str | None, *, graph: bool = True) -> Status:
    """Return what runs where, for one release.

    Args:
        graph: let guests look from inside its pods, at DDS discovery for example; takes seconds.

    Raises:
        UserError: the cluster has nothing of it.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        state = read_status(cluster, found.id)
        if not graph:
            return Status(state)
        additions = (guest.status(cluster, state) for guest in load_guests())
        return Status(state, [one for one in additions if one])


def releases(settings: Settings, *, everywhere: bool) -> tuple[list[str], list[ReleaseSummary]]:
    """Return the listed namespaces, none for all, and their releases.

    They are those of the Rigelfile, if there is one, or the context's.

    Raises:
        Forbidden: the right to list Secrets or workloads is missing.
    """
    with connect(settings) as cluster:
        namespaces = [] if everywhere else list_namespaces(settings, cluster)
        asked: Sequence[str | None] = namespaces or (None,)
        try:
            found = [list_releases(cluster, name) for name in asked]
        except Forbidden as error:
            if everywhere:
                error.hint = "list one namespace only with `rigel list -n NAMESPACE`, without -A"
            raise
    return namespaces, [one for part in found for one in part]
