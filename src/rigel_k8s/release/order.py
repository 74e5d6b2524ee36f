"""The order of kinds: what others need is created before them, and deleted after them."""

from __future__ import annotations

FIRST = ("Namespace", "CustomResourceDefinition", "PriorityClass", "StorageClass")
ORDER = (
    *FIRST,
    "ServiceAccount",
    "Role",
    "ClusterRole",
    "RoleBinding",
    "ClusterRoleBinding",
    "ResourceQuota",
    "LimitRange",
    "ConfigMap",
    "Secret",
    "PersistentVolume",
    "PersistentVolumeClaim",
    "NetworkAttachmentDefinition",
    "NetworkPolicy",
    "Service",
)
BINDINGS = ("RoleBinding", "ClusterRoleBinding")
#: Kinds that run pods, and the pod itself.
WORKLOADS = ("DaemonSet", "StatefulSet", "Deployment", "Job", "CronJob", "Pod")
#: The kinds of workloads that a release's own objects have, with their API versions.
RUNNING = (
    ("apps/v1", "Deployment"),
    ("apps/v1", "DaemonSet"),
    ("apps/v1", "StatefulSet"),
    ("batch/v1", "Job"),
)
#: Kinds that hold data: they are deleted only on request. With a definition every object of its
#: kind is deleted, of all applications.
PROTECTED = frozenset({"PersistentVolumeClaim", "PersistentVolume", "CustomResourceDefinition"})


def rank(kind: str) -> int:
    """Return the place of a kind in the order of apply; unknown kinds come before pods."""
    if kind in ORDER:
        return ORDER.index(kind)
    return len(ORDER) + (1 + WORKLOADS.index(kind) if kind in WORKLOADS else 0)


def wave(kind: str) -> int:
    """Return which objects are applied together: 0 what defines kinds, 1 the rest, then workloads.

    Bindings are between them: a user without the right to bind any Role may bind an existing one.
    """
    if kind in FIRST:
        return 0
    if kind in WORKLOADS:
        return 3
    return 2 if kind in BINDINGS else 1
