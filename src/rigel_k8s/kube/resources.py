"""Which URL a kind has: a table of Kubernetes' own kinds, discovery for all others."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import quote, urlencode

import attrs


@attrs.frozen
class Resource:
    """How the API calls a kind."""

    plural: str
    namespaced: bool


BUILT_IN: Mapping[str, str] = {
    "v1": (
        "configmaps:ConfigMap endpoints:Endpoints events:Event limitranges:LimitRange pods:Pod "
        "persistentvolumeclaims:PersistentVolumeClaim resourcequotas:ResourceQuota "
        "secrets:Secret services:Service serviceaccounts:ServiceAccount "
        "namespaces:Namespace! nodes:Node! persistentvolumes:PersistentVolume!"
    ),
    "apps/v1": (
        "daemonsets:DaemonSet deployments:Deployment replicasets:ReplicaSet "
        "statefulsets:StatefulSet"
    ),
    "authorization.k8s.io/v1": (
        "selfsubjectaccessreviews:SelfSubjectAccessReview! "
        "selfsubjectrulesreviews:SelfSubjectRulesReview!"
    ),
    "batch/v1": "cronjobs:CronJob jobs:Job",
    "coordination.k8s.io/v1": "leases:Lease",
    "networking.k8s.io/v1": "ingresses:Ingress networkpolicies:NetworkPolicy",
    "policy/v1": "poddisruptionbudgets:PodDisruptionBudget",
    "rbac.authorization.k8s.io/v1": (
        "roles:Role rolebindings:RoleBinding "
        "clusterroles:ClusterRole! clusterrolebindings:ClusterRoleBinding!"
    ),
    "scheduling.k8s.io/v1": "priorityclasses:PriorityClass!",
    "storage.k8s.io/v1": "storageclasses:StorageClass!",
    "apiextensions.k8s.io/v1": "customresourcedefinitions:CustomResourceDefinition!",
}


def built_in() -> dict[tuple[str, str], Resource]:
    """Return the table, by API version and kind; `!` marks a cluster-wide kind."""
    table = {}
    for version, words in BUILT_IN.items():
        for word in words.split():
            plural, kind = word.split(":")
            table[version, kind.rstrip("!")] = Resource(plural, not kind.endswith("!"))
    return table


class ApiResources:
    """Finds kinds; queries the cluster once for each API version that the table does not have."""

    def __init__(self, fetch: Callable[[str], Mapping[str, Any] | None]):
        """`fetch` returns an API version's resource list, None for an unknown version."""
        self.fetch = fetch
        self.table = built_in()
        self.lock = threading.Lock()

    def find(self, api_version: str, kind: str) -> Resource | None:
        """Return the API's name for a kind, None if the cluster does not have it."""
        with self.lock:
            if (api_version, kind) not in self.table:
                self.discover(api_version)
            return self.table.get((api_version, kind))

    def discover(self, api_version: str) -> None:
        """Add one API version's kinds; a kind that does not exist now may exist later."""
        for entry in (self.fetch(api_version) or {}).get("resources") or []:
            if "/" not in entry["name"]:
                resource = Resource(entry["name"], bool(entry.get("namespaced")))
                self.table[api_version, entry["kind"]] = resource


def path(
    api_version: str,
    resource: Resource | None = None,
    namespace: str = "",
    name: str = "",
    subresource: str = "",
    *,
    query: Mapping[str, object] | None = None,
) -> str:
    """Return the path and query of a URL; query values that are None or "" are left out."""
    parts = ["api" if "/" not in api_version else "apis", *api_version.split("/")]
    if resource is not None:
        parts += ["namespaces", namespace] if resource.namespaced and namespace else []
        parts += [resource.plural, *filter(None, (name, subresource))]
    return with_query("/" + "/".join(quote(part, safe="") for part in parts), query)


def with_query(url: str, query: Mapping[str, object] | None) -> str:
    """Return a URL with its query; values that are None or "" are left out."""
    said = {key: value for key, value in (query or {}).items() if value not in (None, "", False)}
    return f"{url}?{urlencode(said, doseq=True)}" if said else url
