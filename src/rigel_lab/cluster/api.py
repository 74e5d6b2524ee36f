"""Requests to a cluster's API server, as its administrator."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import urllib3

from rigel_k8s.errors import ClusterError, ConflictError, LocalClusterError
from rigel_k8s.kube import Cluster, Manifest, ObjectRef
from rigel_k8s.kube.target import Credentials, Target
from rigel_k8s.objects.facts import is_ready as is_ready_node
from rigel_k8s.system.tls import trust
from rigel_lab.cluster import k3s, kubeconfig
from rigel_lab.cluster.components import KUBERNETES_VERSION
from rigel_lab.cluster.layout import SERVER, Layout


def is_ready(layout: Layout) -> bool:
    """Return whether /readyz answers ok."""
    context = trust(layout.authority().certificate.read_text())
    try:
        with urllib3.PoolManager(ssl_context=context, retries=False, timeout=2) as http:
            return http.request("GET", f"{layout.server}/readyz").status == 200
    except urllib3.exceptions.HTTPError:
        return False


def wait_until_ready(layout: Layout, seconds: float = 90) -> None:
    """Wait until the API server reports that it is ready.

    Raises:
        LocalClusterError: it is not within the time; the details are its last log lines.
    """
    deadline = time.monotonic() + seconds
    while not is_ready(layout):
        if time.monotonic() > deadline:
            log = layout.directory / "control-plane/logs/kube-apiserver.log"
            raise LocalClusterError(
                f"the API server was not ready after {seconds:.0f} s",
                details=log.read_text().splitlines()[-10:] if log.exists() else (),
                hint=f"its log: {log}; start over with `rigel cluster down --name {layout.name}`",
            )
        time.sleep(0.1)


def admin(layout: Layout) -> tuple[Path, Path]:
    """Return the administrator's certificate and key."""
    return layout.authority().issue("admin", "kubernetes-admin", organization="system:masters")


def access(layout: Layout, context: str, server: str | None = None) -> dict[str, Any]:
    """Return a kubeconfig of the administrator, with the keys inside."""
    authority = layout.authority().certificate
    return kubeconfig.entries(context, server or layout.server, authority, *admin(layout))


def connect(layout: Layout) -> Cluster:
    """Return a client of the API server, as administrator."""
    certificate, key = admin(layout)
    credentials = Credentials(certificate.read_text(), key.read_text())
    target = Target(
        layout.server,
        f"rigel-{layout.name}",
        authority=layout.authority().certificate.read_text(),
        credentials=lambda: credentials,
    )
    return Cluster(target)


def create_nodes(layout: Layout, nodes: Sequence[str]) -> None:
    """Create the Node objects with their pod ranges; the kubelets find and fill them."""
    with connect(layout) as cluster:
        for node in nodes:
            with suppress(ConflictError):  # if the control plane was started again
                cluster.create(node_object(layout, node))


def apply(layout: Layout, manifests: Iterable[Manifest]) -> None:
    """Apply manifests in their order; what others have changed in them is reset."""
    with connect(layout) as cluster:
        for manifest in manifests:
            cluster.apply(manifest, force=True)


def node_object(layout: Layout, name: str) -> dict[str, Any]:
    """Return a Node before its kubelet starts; k3s records the arguments it was started with."""
    meta: dict[str, Any] = {"name": name, "labels": {"kubernetes.io/hostname": name}}
    if data_dir := layout.nodes.data_dir:
        server = name == SERVER
        meta["labels"] |= k3s.node_labels(server=server)
        meta["annotations"] = k3s.node_annotations(data_dir, KUBERNETES_VERSION, server=server)
    pods = layout.addresses.pod_range(name)
    spec = {"podCIDR": pods, "podCIDRs": [pods]}
    return {"apiVersion": "v1", "kind": "Node", "metadata": meta, "spec": spec}


def mark_lost(layout: Layout, node: str) -> None:
    """Mark a node that has ended as not Ready; the cluster itself would notice it later."""
    condition = {"type": "Ready", "status": "Unknown", "reason": "MachineEnded"}
    patch = {"status": {"conditions": [condition]}}
    ref = ObjectRef("v1", "Node", "", node)
    # The node is started again in any case, even if its object was deleted.
    with connect(layout) as cluster, suppress(ClusterError):
        cluster.patch(ref, patch, style="strategic", subresource="status")


def find_ready_nodes(layout: Layout) -> set[str]:
    """Return the names of the nodes that the cluster reports as Ready."""
    with connect(layout) as cluster:
        nodes = cluster.nodes()
    return {node["metadata"]["name"] for node in nodes if is_ready_node(node)}


def wait_for_deployment(layout: Layout, namespace: str, name: str, seconds: float = 120) -> None:
    """Wait until the pods of a Deployment's present template are ready.

    Raises:
        LocalClusterError: they are not within the time; the details are the Deployment's reasons.
    """
    deadline = time.monotonic() + seconds
    ref = ObjectRef("apps/v1", "Deployment", namespace, name)
    with connect(layout) as cluster:
        while not is_rolled_out(found := cluster.get(ref) or {}):
            if time.monotonic() > deadline:
                stated = (found.get("status") or {}).get("conditions") or []
                raise LocalClusterError(
                    f"{name} was not ready after {seconds:.0f} s",
                    details=[str(each.get("message")) for each in stated],
                    hint=f"the logs of its pods: {layout.directory}/node*/pod-logs/{namespace}_*",
                )
            time.sleep(0.2)


def is_rolled_out(deployment: Manifest) -> bool:
    """Return whether all pods of a Deployment are of its present template and available."""
    status = deployment.get("status") or {}
    if status.get("observedGeneration", 0) < deployment.get("metadata", {}).get("generation", 1):
        return False
    wanted = deployment["spec"]["replicas"]
    counts = (status.get(key, 0) for key in ("replicas", "updatedReplicas", "availableReplicas"))
    return all(count == wanted for count in counts)
