"""Pods that take part in DDS, as the API server returns them, and as discovery reads them."""

from __future__ import annotations

import json
from typing import Any

import attrs

from rigel_graph.discovery.members import Member, members

NOTE = {"mode": "macvlan", "interface": "net1", "domain": 3, "middleware": "fastdds", "ros": "2"}
PROBE = ["/bin/sh", "/rigel-k8s/ready.sh", "dds", "--domain", "3"]
STATUS = [
    {"name": "pods", "interface": "eth0", "ips": ["10.244.1.2"], "default": True},
    {"name": "lan", "interface": "net1", "ips": ["fd00::1", "10.1.0.7"]},
]


def pod(name: str = "talker-1", note: Any = NOTE, **more: Any) -> dict[str, Any]:
    annotations = {"k8s.v1.cni.cncf.io/network-status": json.dumps(STATUS)}
    if note is not None:
        annotations["rigel-k8s/network"] = json.dumps(note)
    mounts = [{"name": "rigel-inpod", "mountPath": "/rigel-k8s"}]
    container = {
        "name": "ros-node",
        "volumeMounts": mounts,
        "env": more.pop("env", []),
        "readinessProbe": {"exec": {"command": more.pop("probe", PROBE)}},
    }
    return {
        "metadata": {
            "name": name,
            "namespace": "robots",
            "labels": {"app.kubernetes.io/name": "talker"},
            "annotations": annotations,
            **more,
        },
        "spec": {"nodeName": "node1", "containers": [{"name": "sidecar"}, container]},
        "status": {
            "podIP": "10.244.1.2",
            "conditions": [{"type": "Ready", "status": "True"}],
            "containerStatuses": [
                {"name": "ros-node", "restartCount": 0, "state": {"running": {}}}
            ],
        },
    }


def member(name: str, machine: str = "node1", **more: Any) -> Member:
    (found,) = members([pod(name)])
    return attrs.evolve(found, machine=machine, workload=name, address=None, **more)
