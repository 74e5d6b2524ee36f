"""A real, unmodified Kubernetes on this machine, for people without a cluster and for our tests.

Each machine of it (the control plane, every node) is a set of Linux namespaces; all are on one
Ethernet segment of their own. It knows nothing of Rigelfiles or jobs.
"""

from __future__ import annotations

from rigel_k8s.localcluster.extras import EXTRAS
from rigel_k8s.localcluster.lifecycle import DEFAULT_NAME, down, up
from rigel_k8s.localcluster.loading import load
from rigel_k8s.localcluster.paths import names
from rigel_k8s.localcluster.status import (
    ClusterStatus,
    NodeStatus,
    kubeconfig_text,
    registries,
    status,
)
from rigel_k8s.localcluster.wish import DEFAULT_NODES, LAYOUTS

__all__ = [
    "DEFAULT_NAME",
    "DEFAULT_NODES",
    "EXTRAS",
    "LAYOUTS",
    "ClusterStatus",
    "NodeStatus",
    "down",
    "kubeconfig_text",
    "load",
    "names",
    "registries",
    "status",
    "up",
]
