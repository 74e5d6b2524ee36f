"""list: the releases of a namespace or of the whole cluster."""

from __future__ import annotations

from rigel_k8s.kube import connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.release.listing import ReleaseSummary, list_releases
from rigel_k8s.settings import Settings


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
