"""Which kinds come first: what others need is there before them, and goes after them."""

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
#: Kinds that hold data: they go only when that is asked for. With a definition goes every object of
#: its kind, of all applications.
PROTECTED = frozenset({"PersistentVolumeClaim", "PersistentVolume", "CustomResourceDefinition"})


def rank(kind: str) -> int:
    """Return where a kind stands in the order of apply; kinds we do not know come before pods."""
    if kind in ORDER:
        return ORDER.index(kind)
    return len(ORDER) + (1 + WORKLOADS.index(kind) if kind in WORKLOADS else 0)


def wave(kind: str) -> int:
    """Return which objects are applied at once: 0 what defines kinds, 1 the rest, then workloads.

    Between them are bindings: a user without the right to bind any Role may bind one that is there.
    """
    if kind in FIRST:
        return 0
    if kind in WORKLOADS:
        return 3
    return 2 if kind in BINDINGS else 1
