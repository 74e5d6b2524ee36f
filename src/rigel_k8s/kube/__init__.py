"""The Kubernetes API on plain dicts; the only package that speaks HTTP to a cluster.

A `Cluster` (`cluster`) reads and writes objects (`store`), watches them (`watching`), runs programs
in pods (`execution`) and forwards ports (`forwarding`). Below it, `client` makes requests of that,
and `transport` sends them on `connections`, again where that is safe. `kubeconfig`, `target` and
`credentials` say which cluster and who asks; `failures` are its refusals. Importing this package
costs nothing: HTTP and TLS are imported when a cluster is used. docs/architecture.md explains why
the client is our own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rigel_k8s.objects.refs import Manifest, ObjectRef

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.settings import Settings

__all__ = ["Cluster", "Manifest", "ObjectRef", "connect"]


def connect(settings: Settings) -> Cluster:
    """Return a client of the cluster that the settings name; no request is made yet.

    Raises:
        UserError: the kubeconfig or the context is missing or invalid.
    """
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.kube.kubeconfig import load

    return Cluster(load(settings.kubeconfig, settings.context))


def __getattr__(name: str) -> Any:
    """Return `Cluster` lazily: its module imports HTTP and TLS."""
    if name != "Cluster":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from rigel_k8s.kube.cluster import Cluster

    return Cluster
