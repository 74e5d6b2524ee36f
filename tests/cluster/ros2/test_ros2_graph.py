"""The DDS graph of real ROS 2 nodes on a real cluster, as `rigel` looks at it from inside pods."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

import pytest

from rigel_graph.discovery import check as graph
from rigel_inpod import scripts
from rigel_k8s.network.wiring import NETWORK_ANNOTATION
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import ReleaseId
from tests.support.recorder import Recorder
from tests.support.until import until

pytestmark = pytest.mark.cluster

NODE = """
import rclpy, sys
rclpy.init()
rclpy.spin(rclpy.create_node(sys.argv[1]))
"""


class Release:
    """Pods as a deploy makes them, each on a machine of the test's choice."""

    def __init__(self, cluster: Any, namespace: str, image: str, mode: str) -> None:
        self.cluster, self.namespace, self.image, self.mode = cluster, namespace, image, mode
        self.id = ReleaseId(namespace, "graph")
        self.report = Recorder()
        self.apply("ConfigMap", "inpod", data=scripts())

    def apply(self, kind: str, name: str, **rest: Any) -> None:
        meta = {"name": name, "namespace": self.namespace, **rest.pop("metadata", {})}
        self.cluster.apply({"apiVersion": "v1", "kind": kind, "metadata": meta, **rest})

    def node(self, name: str, machine: str) -> None:
        """Start one ROS 2 node in a pod."""
        note = {"mode": self.mode, "domain": 77, "ros": "2", "middleware": "fastdds"}
        variables = {"ROS_DOMAIN_ID": "77", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
        probe = ["/bin/sh", "/rigel-k8s/ready.sh", "dds", "--domain", "77"]
        container = {
            "name": "ros-node",
            "image": self.image,
            "args": ["python3", "-c", NODE, name],
            "env": [{"name": k, "value": v} for k, v in variables.items()],
            "volumeMounts": [{"name": "inpod", "mountPath": "/rigel-k8s"}],
            "readinessProbe": {
                "exec": {"command": probe},
                "periodSeconds": 1,
                "timeoutSeconds": 5,
            },
        }
        spec = {
            "nodeName": machine,
            "terminationGracePeriodSeconds": 0,
            "containers": [container],
            "volumes": [{"name": "inpod", "configMap": {"name": "inpod"}}],
        }
        labels = {RELEASE_LABEL: "graph", NAME_LABEL: name}
        metadata = {"labels": labels, "annotations": {NETWORK_ANNOTATION: json.dumps(note)}}
        self.apply("Pod", name, metadata=metadata, spec=spec)

    def ready(self, *names: str) -> None:
        """Wait until pods are ready."""
        for name in names:
            ref = ObjectRef("v1", "Pod", self.namespace, name)
            until(lambda ref=ref: is_ready(self.cluster.get(ref)), f"ready pod {name}", 120)

    def deaf(self) -> tuple[tuple[str, str], ...]:
        """Return the machines of which no pods discover each other."""
        found = graph.survey(self.cluster, self.id)
        assert found is not None
        return tuple(found.deaf)

    def check(self) -> None:
        graph.check(self.id, self.cluster, self.report, threading.Event())


@pytest.fixture
def machines(cluster: Any) -> list[str]:
    return [str(node["metadata"]["name"]) for node in cluster.nodes()]


@pytest.fixture
def release(cluster: Any, namespace: str, ros2_image: str) -> Callable[[str], Release]:
    """Make a release in a mode."""
    return lambda mode: Release(cluster, namespace, ros2_image, mode)


def test_pod_network(release: Callable[[str], Release], machines: list[str]):
    """Without a network key the nodes do not discover each other; the way out is reported."""
    made = release("none")
    for name, machine in zip(("one", "two"), machines, strict=False):
        made.node(name, machine)
    made.ready("one", "two")
    made.check()
    told = made.report.texts[-1]
    pair = sorted(machines[:2])
    assert told.startswith(f"the pods on {pair[0]} and {pair[1]} do not discover each other")
    assert "set `network`" in told
    # On a busy machine what a node sends comes late.
    until(lambda: made.deaf() == (tuple(pair),), f"graph in which {pair} are cut off", 120)
