"""A cluster's API server, asked as its administrator."""

from __future__ import annotations

import json
import ssl
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import urllib3

from rigel_k8s.errors import CommandFailed, LocalClusterError
from rigel_lab.cluster import k3s, kubeconfig
from rigel_lab.cluster.commands import run
from rigel_lab.cluster.components import KUBERNETES_VERSION
from rigel_lab.cluster.layout import SERVER, Layout

__all__ = [
    "access",
    "admin",
    "create_nodes",
    "kubectl",
    "mark_lost",
    "ready",
    "ready_nodes",
    "wait_until_ready",
]


def ready(layout: Layout) -> bool:
    """Return whether /readyz answers ok."""
    context = ssl.create_default_context(cafile=str(layout.authority().certificate))
    try:
        with urllib3.PoolManager(ssl_context=context, retries=False, timeout=2) as http:
            return http.request("GET", f"{layout.server}/readyz").status == 200
    except urllib3.exceptions.HTTPError:
        return False


def wait_until_ready(layout: Layout, seconds: float = 90) -> None:
    """Wait until the API server says that it is ready.

    Raises:
        LocalClusterError: it does not within the time; the details are its last log lines.
    """
    deadline = time.monotonic() + seconds
    while not ready(layout):
        if time.monotonic() > deadline:
            log = layout.directory / "control-plane/logs/kube-apiserver.log"
            raise LocalClusterError(
                f"the API server was not ready after {seconds:.0f} s",
                details=log.read_text().splitlines()[-10:] if log.exists() else (),
                hint=f"its log: {log}; `rigel cluster down --name {layout.name}` begins anew",
            )
        time.sleep(0.1)


def admin(layout: Layout) -> Path:
    """Return the administrator's kubeconfig."""
    return layout.kubeconfig("admin", "kubernetes-admin", "system:masters")


def access(layout: Layout, context: str, server: str | None = None) -> dict[str, Any]:
    """Return a kubeconfig of the administrator, with the keys inside."""
    admin(layout)
    ca = layout.authority()
    keys = ca.directory / "admin.crt", ca.directory / "admin.key"
    return kubeconfig.entries(context, server or layout.server, ca.certificate, *keys)


def kubectl(layout: Layout, *words: str) -> str:
    """Run kubectl as administrator and return what it printed."""
    return run([layout.program("kubectl"), f"--kubeconfig={admin(layout)}", *words])


def create_nodes(layout: Layout, nodes: Sequence[str]) -> None:
    """Create the Node objects with their pod ranges; the kubelets find and fill them."""
    path = layout.directory / "nodes.json"
    items = [node_object(layout, node) for node in nodes]
    path.write_text(json.dumps({"apiVersion": "v1", "kind": "List", "items": items}))
    with suppress(CommandFailed):  # AlreadyExists, where the control plane was started again
        kubectl(layout, "create", "-f", str(path))


def node_object(layout: Layout, name: str) -> dict[str, Any]:
    """Return a Node before its kubelet comes; k3s says of itself what it was started with."""
    meta: dict[str, Any] = {"name": name, "labels": {"kubernetes.io/hostname": name}}
    if data_dir := layout.nodes.data_dir:
        server = name == SERVER
        meta["labels"] |= k3s.node_labels(server=server)
        meta["annotations"] = k3s.node_annotations(data_dir, KUBERNETES_VERSION, server=server)
    pods = layout.addresses.pod_range(name)
    spec = {"podCIDR": pods, "podCIDRs": [pods]}
    return {"apiVersion": "v1", "kind": "Node", "metadata": meta, "spec": spec}


def mark_lost(layout: Layout, node: str) -> None:
    """Tell the cluster that a node has ended, which it would believe Ready for a while."""
    condition = {"type": "Ready", "status": "Unknown", "reason": "MachineEnded"}
    patch = json.dumps({"status": {"conditions": [condition]}})
    with suppress(CommandFailed):  # NotFound, where somebody has deleted it
        kubectl(layout, "patch", "node", node, "--subresource=status", f"--patch={patch}")


def ready_nodes(layout: Layout) -> set[str]:
    """Return the names of the nodes that the cluster calls Ready."""
    items = json.loads(kubectl(layout, "get", "nodes", "-o", "json"))["items"]
    found = set()
    for item in items:
        conditions = {c["type"]: c["status"] for c in item["status"].get("conditions", [])}
        if conditions.get("Ready") == "True":
            found.add(item["metadata"]["name"])
    return found
