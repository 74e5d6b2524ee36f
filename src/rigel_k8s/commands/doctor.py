"""doctor: what a deploy needs, asked for one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import attrs

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.facts import is_default_class, is_ready
from rigel_k8s.settings import Settings

NEEDED = (
    ("apps", "deployments"),
    ("", "services"),
    ("", "configmaps"),
    ("", "secrets"),
    ("", "persistentvolumeclaims"),
    ("coordination.k8s.io", "leases"),
)
#: What ROS 1 needs besides, for the gate in front of roscore; the role `edit` does not have it.
NEEDED_BY_GATE = (
    ("", "serviceaccounts"),
    ("rbac.authorization.k8s.io", "roles"),
    ("rbac.authorization.k8s.io", "rolebindings"),
)

#: A deploy needs no right to see them.
UNSEEN = "not to be seen with your rights, which a deploy does not need"


@attrs.frozen
class DoctorFinding:
    """One thing that a deploy needs: whether it is there, and what to do where it is not."""

    what: str
    ok: bool
    found: str
    hint: str = ""


def examine(settings: Settings) -> list[DoctorFinding]:
    """Return what was found; the first thing that is missing ends the search."""
    try:
        with connect(settings) as cluster:
            version = cluster.server_version()
            where = cluster.context_name or "in-cluster"
            return [
                DoctorFinding("cluster", ok=True, found=f"{where} at {cluster.server}, {version}"),
                *rights(cluster, settings.namespace or cluster.namespace),
                nodes(cluster),
                storage(cluster),
            ]
    except RigelK8sError as error:
        return [DoctorFinding("cluster", ok=False, found=error.message, hint=error.hint or "")]


def rights(cluster: Cluster, namespace: str) -> Iterator[DoctorFinding]:
    """Ask the API server whether we may write what a release is made of."""

    def list_refused(needed: Iterable[tuple[str, str]]) -> str:
        names = (name for group, name in needed if not may_patch(cluster, namespace, group, name))
        return ", ".join(names)

    refused = list_refused(NEEDED)
    yield DoctorFinding(
        f"rights in {namespace}",
        ok=not refused,
        found=f"none to write {refused}" if refused else "all that a release needs",
        hint="ask for the role `edit` in this namespace",
    )
    lacking = list_refused(NEEDED_BY_GATE)
    without = f"none to write {lacking}: ROS 1 needs `gate: false`, or the role `admin` here"
    yield DoctorFinding(
        f"rights for a gate in {namespace}",
        ok=True,
        found=without if lacking else "all that ROS 1's gate needs",
    )


def may_patch(cluster: Cluster, namespace: str, group: str, resource: str) -> bool:
    """Return whether we may patch a resource in a namespace."""
    attributes = {"namespace": namespace, "verb": "patch", "group": group, "resource": resource}
    review = cluster.create(
        {
            "apiVersion": "authorization.k8s.io/v1",
            "kind": "SelfSubjectAccessReview",
            "metadata": {},
            "spec": {"resourceAttributes": attributes},
        }
    )
    return bool(review["status"]["allowed"])


def nodes(cluster: Cluster) -> DoctorFinding:
    """Tell which machines are ready."""
    ready: list[str] = []
    other: list[str] = []
    try:
        there = cluster.nodes()
    except Forbidden:
        return DoctorFinding("nodes", ok=True, found=UNSEEN)
    for node in there:
        names = ready if is_ready(node) else other
        names.append(node["metadata"]["name"])
    found = f"{len(ready)} ready" + (f", not ready: {', '.join(other)}" if other else "")
    return DoctorFinding("nodes", ok=bool(ready), found=found, hint="kubectl describe node NAME")


def storage(cluster: Cluster) -> DoctorFinding:
    """Tell the default StorageClass; without one, claims need a storage_class or host_path."""
    try:
        classes = cluster.list("storage.k8s.io/v1", "StorageClass")
    except Forbidden:
        return DoctorFinding("storage", ok=True, found=UNSEEN)
    default = [one["metadata"]["name"] for one in classes if is_default_class(one)]
    found = f"default class {default[0]}" if default else "no default StorageClass"
    hint = "give each volume a storage_class or a host_path"
    return DoctorFinding("storage", ok=bool(default), found=found, hint=hint)
