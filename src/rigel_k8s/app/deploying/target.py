"""Which release a job's options name; known before anything is prepared."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster


def release_of(options: Any, settings: Settings, cluster: Cluster | None = None) -> ReleaseId:
    """Return the release: -n, else the Rigelfile's namespace, else the context's, else default."""
    namespace = settings.namespace or options.namespace
    if not namespace:
        namespace = cluster.namespace if cluster else context_namespace(settings)
    return ReleaseId(str(namespace), str(options.deployment_name))


def release_key(options: Any, settings: Settings) -> str:
    """Return what two jobs that deploy one release have in common, as a text for messages."""
    namespace = settings.namespace or options.namespace
    return f"release {options.deployment_name}{f' in {namespace}' if namespace else ''}"


def context_namespace(settings: Settings) -> str:
    """Return the context's namespace without a request; without a context it is `default`."""
    from rigel_k8s.kube import connect

    try:
        with connect(settings) as cluster:
            return cluster.namespace
    except RigelK8sError:
        return "default"
