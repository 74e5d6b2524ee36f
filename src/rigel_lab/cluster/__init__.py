"""A real, unmodified Kubernetes on this machine, for people without a cluster and for our tests.

Each machine of it (the control plane, every node) is a set of Linux namespaces; all are on one
Ethernet segment of their own. It is independent of Rigelfiles and jobs.
"""

from __future__ import annotations

from rigel_lab.cluster.addons import EXTRAS
from rigel_lab.cluster.commands import StepProgress
from rigel_lab.cluster.lifecycle import DEFAULT_NAME, down, up
from rigel_lab.cluster.loading import load
from rigel_lab.cluster.paths import names
from rigel_lab.cluster.status import ClusterStatus, NodeStatus, kubeconfig_text, registries, status
from rigel_lab.cluster.wish import DEFAULT_NODES

__all__ = [
    "DEFAULT_NAME",
    "DEFAULT_NODES",
    "EXTRAS",
    "ClusterStatus",
    "NodeStatus",
    "StepProgress",
    "down",
    "kubeconfig_text",
    "load",
    "names",
    "registries",
    "status",
    "up",
]
