"""A real, unmodified Kubernetes on this machine, for people without a cluster and for our tests.

Each machine of it (the control plane, every node) is a set of Linux namespaces; all are on one
Ethernet segment of their own. It knows nothing of Rigelfiles or jobs.
"""

from __future__ import annotations

from rigel_k8s.localcluster.cluster import (
    DEFAULT_NAME,
    ClusterStatus,
    NodeStatus,
    down,
    kubeconfig_text,
    load,
    names,
    status,
    up,
)

__all__ = [
    "DEFAULT_NAME",
    "ClusterStatus",
    "NodeStatus",
    "down",
    "kubeconfig_text",
    "load",
    "names",
    "status",
    "up",
]
