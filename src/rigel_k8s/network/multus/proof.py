"""The proof that a machine attaches pods: one short pod on it, with a second network.

The network is a `ptp` link with an address of whereabouts' (from the range of RFC 2544, which no
network uses): it needs no interface of the machine, leaves nothing there when it ends, and uses
Multus, whereabouts and the CNI programs as an application does. Whether macvlan works depends on
the interface (a wireless one refuses it); the preflight checks that.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.machines import EVERYWHERE
from rigel_k8s.network.wiring import NETWORKS_ANNOTATION

Object = dict[str, Any]

PROOF = "rigel-network-proof"
#: The label of all objects of one proof.
RUN_LABEL = "rigel-k8s/network-proof"
RANGE = "198.18.0.0/16"
#: Seconds after which Kubernetes ends a pod that a killed `rigel` has left.
LONGEST = 300


def proof_attachment(run: str) -> Object:
    """Return the network, for one run of the proof."""
    ipam = {
        "type": "whereabouts",
        "range": RANGE,
        "range_start": "198.18.0.10",
        "gateway": "198.18.0.1",
        "network_name": PROOF,
    }
    config = {"cniVersion": "0.3.1", "name": f"{PROOF}-{run}", "type": "ptp", "ipam": ipam}
    return {
        "apiVersion": "k8s.cni.cncf.io/v1",
        "kind": "NetworkAttachmentDefinition",
        "metadata": {
            "name": f"{PROOF}-{run}",
            "namespace": RELEASE.namespace,
            "labels": {RUN_LABEL: run},
        },
        "spec": {"config": json.dumps(config, sort_keys=True)},
    }


def proof_pool() -> str:
    """Return the name of the pool that whereabouts makes for it."""
    return f"{PROOF}-{RANGE.replace('/', '-')}"


def proof_pod(run: str, node: str, image: str) -> Object:
    """Return the pod on one machine: it succeeds if it has the interface net1."""
    digest = hashlib.sha256(node.encode()).hexdigest()[:10]
    container = {
        "name": "proof",
        "image": image,
        "imagePullPolicy": "IfNotPresent",
        "command": ["/bin/sh", "-c", "test -d /sys/class/net/net1"],
        "resources": {"requests": {"cpu": "1m", "memory": "4Mi"}, "limits": {"memory": "32Mi"}},
        "securityContext": {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        },
    }
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {
            "name": f"{PROOF}-{run}-{digest}",
            "namespace": RELEASE.namespace,
            "labels": {RUN_LABEL: run},
            "annotations": {NETWORKS_ANNOTATION: f"{PROOF}-{run}"},
        },
        "spec": {
            "nodeName": node,
            "tolerations": list(EVERYWHERE),
            "restartPolicy": "Never",
            "activeDeadlineSeconds": LONGEST,
            "terminationGracePeriodSeconds": 0,
            "automountServiceAccountToken": False,
            "enableServiceLinks": False,
            "containers": [container],
        },
    }
