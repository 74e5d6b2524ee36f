"""The DDS graph of real ROS 2 nodes on a real cluster, as `rigel` looks at it from inside pods."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_inpod import scripts
from rigel_k8s.discovery import check as graph
from rigel_k8s.discovery.findings import DiscoveryGraph
from rigel_k8s.network.wiring import NETWORK_ANNOTATION
from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rosgraph.reading import read_graph
from tests.support.recorder import Recorder
from tests.support.until import until

pytestmark = pytest.mark.cluster

NODE = """
import rclpy, sys
rclpy.init()
rclpy.spin(rclpy.create_node(sys.argv[1]))
"""
#: The node as a child: nothing stops a container's process 1.
SHELL = 'python3 -c "$0" "$1"; true'
#: Stops the node.
STOP = """
import glob, os, signal
for path in glob.glob("/proc/[0-9]*/cmdline"):
    words = open(path, "rb").read().split(b"\\0")
    if words[0].endswith(b"python3") and words[-2] == b"two":
        os.kill(int(path.split("/")[2]), signal.SIGSTOP)
"""
ATTACHMENTS = "k8s.cni.cncf.io/v1"


class Release:
    """Pods as a deploy makes them, each on a machine of the test's choice."""

    def __init__(self, cluster: Any, namespace: str, image: str, mode: str) -> None:
        self.cluster, self.namespace, self.image, self.mode = cluster, namespace, image, mode
        self.id = ReleaseId(namespace, "graph")
        self.report = Recorder()
        self.apply("v1", "ConfigMap", "inpod", data=scripts())

    def apply(self, api_version: str, kind: str, name: str, **rest: Any) -> None:
        meta = {"name": name, "namespace": self.namespace, **rest.pop("metadata", {})}
        self.cluster.apply({"apiVersion": api_version, "kind": kind, "metadata": meta, **rest})

    def attachment(self) -> None:
        """Macvlan on the machines' own interface, addresses by whereabouts."""
        config = {
            "cniVersion": "0.3.1",
            "type": "macvlan",
            "master": "eth0",
            "mode": "bridge",
            "ipam": {"type": "whereabouts", "range": "10.231.0.0/24"},
        }
        spec = {"config": json.dumps(config)}
        self.apply(ATTACHMENTS, "NetworkAttachmentDefinition", "lan", spec=spec)

    def node(self, name: str, machine: str, env: dict[str, str] | None = None) -> None:
        """Start one ROS 2 node in a pod."""
        second = self.mode == "macvlan"
        note = {"mode": self.mode, "domain": 77, "ros": "2", "middleware": "fastdds"}
        annotations = {NETWORK_ANNOTATION: json.dumps({**note, "interface": "net1"})}
        annotations["k8s.v1.cni.cncf.io/networks"] = "lan"
        if not second:
            annotations = {NETWORK_ANNOTATION: json.dumps(note)}
        variables = {"ROS_DOMAIN_ID": "77", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **(env or {})}
        probe = ["/bin/sh", "/rigel-k8s/ready.sh", "dds", "--domain", variables["ROS_DOMAIN_ID"]]
        container = {
            "name": "ros-node",
            "image": self.image,
            "args": ["sh", "-c", SHELL, NODE, name.replace("-", "_")],
            "env": [{"name": k, "value": v} for k, v in variables.items()],
            "volumeMounts": [{"name": "inpod", "mountPath": "/rigel-k8s"}],
            "readinessProbe": {
                "exec": {"command": [*probe, *(["--interface", "net1"] if second else [])]},
                "periodSeconds": 1,
                "timeoutSeconds": 5,
            },
        }
        labels = {RELEASE_LABEL: "graph", NAME_LABEL: name}
        spec = {
            "nodeName": machine,
            "terminationGracePeriodSeconds": 0,
            "containers": [container],
            "volumes": [{"name": "inpod", "configMap": {"name": "inpod"}}],
        }
        metadata = {"labels": labels, "annotations": annotations}
        self.apply("v1", "Pod", name, metadata=metadata, spec=spec)

    def ready(self, *names: str, seconds: float = 120) -> None:
        """Wait until pods are ready."""
        end = time.monotonic() + seconds
        for name in names:
            while not self.is_ready(name):
                assert time.monotonic() < end, f"{name} is not ready"
                time.sleep(0.2)

    def unready(self, name: str, seconds: float = 120) -> None:
        """Wait until a pod is ready no more."""
        end = time.monotonic() + seconds
        while self.is_ready(name):
            assert time.monotonic() < end, f"{name} is still ready"
            time.sleep(0.2)

    def is_ready(self, name: str) -> bool:
        pod = self.cluster.get(ObjectRef("v1", "Pod", self.namespace, name))
        conditions = (pod or {}).get("status", {}).get("conditions", [])
        return any(c["type"] == "Ready" and c["status"] == "True" for c in conditions)

    def look(self) -> DiscoveryGraph:
        found = graph.survey(self.cluster, self.id)
        assert found is not None
        return found

    def looked(self, shows: Callable[[DiscoveryGraph], bool], what: str) -> DiscoveryGraph:
        """Look until a look shows something: on a busy machine what a node sends comes late."""

        def look() -> DiscoveryGraph | None:
            found = self.look()
            return found if shows(found) else None

        return until(look, what, 120, last_words=self.look)

    def check(self) -> None:
        graph.check(self.id, self.cluster, self.report, threading.Event())


@pytest.fixture
def machines(cluster: Any) -> list[str]:
    return [str(node["metadata"]["name"]) for node in cluster.nodes()]


@pytest.fixture
def release(
    cluster: Any, namespace: str, ros2_image: str, multus: None
) -> Callable[[str], Release]:
    """Make a release in a mode."""
    return lambda mode: Release(cluster, namespace, ros2_image, mode)


def test_macvlan(release: Callable[[str], Release], machines: list[str]):
    """Over macvlan all nodes discover each other, from machine to machine, at their addresses."""
    made = release("macvlan")
    made.attachment()
    names = [f"node-{i}" for i in range(4)]
    for i, name in enumerate(names):
        made.node(name, machines[i % len(machines)])
    made.ready(*names)

    def is_whole(found: DiscoveryGraph) -> bool:
        return not found.problems and all(len(p.discovered_by or ()) == 3 for p in found.pods)

    found = made.looked(is_whole, "graph in which all discover each other")
    assert [p.pod for p in found.pods] == names
    for pod in found.pods:
        assert pod.discovered_by == tuple(n for n in names if n != pod.pod)
        assert pod.address.startswith("10.231.0.")
    made.check()
    assert "all 4 nodes discover each other" in made.report.texts[-1]
    nodes = [(f"/{name.replace('-', '_')}", name, True) for name in names]
    log = ("/rosout", tuple(name for name, *_ in nodes), "rcl_interfaces/msg/Log")

    def is_read() -> bool:
        read = read_graph(made.cluster, made.id)
        return [(one.name, one.pod, one.up) for one in read.nodes] == nodes and log in [
            (topic.name, topic.publishers, topic.type) for topic in read.topics
        ]

    until(is_read, f"graph with {nodes} and {log}", 120)


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
    made.looked(lambda found: found.deaf == (tuple(pair),), f"graph in which {pair} are cut off")


def test_wrong_domain(release: Callable[[str], Release], machines: list[str]):
    """A node in another domain is named."""
    made = release("macvlan")
    made.attachment()
    made.node("one", machines[0])
    made.node("two", machines[1], env={"ROS_DOMAIN_ID": "5"})
    made.ready("one", "two")
    found = made.looked(lambda found: kinds(found) == ["no-participant"], "wrong domain alone")
    assert "two has no DDS participant" in found.problems[0].message
    assert "domain" in found.problems[0].remedy


def test_stopped(release: Callable[[str], Release], machines: list[str]):
    """A node that hangs gets unready, and is not discovered."""
    made = release("macvlan")
    made.attachment()
    made.node("one", machines[0])
    made.node("two", machines[1])
    made.ready("one", "two")
    made.cluster.run(made.namespace, "two", ["python3", "-c", STOP])
    made.unready("two")
    made.looked(lambda found: kinds(found) == ["no-participant"], "stopped node alone")


def test_cut_off(
    release: Callable[[str], Release],
    machines: list[str],
    namespace: str,
    monkeypatch: pytest.MonkeyPatch,
):
    """A pod that receives nothing from another machine: the machines are named, as an error."""
    monkeypatch.setattr(graph, "PATIENCE", 0.0)
    made = release("macvlan")
    made.attachment()
    made.node("one", machines[0])
    made.node("two", machines[1])
    made.ready("one", "two")
    inside = entering(made.cluster, namespace, "one")
    before = made.looked(lambda found: all(p.address for p in found.pods), "both addresses")
    address = next(pod.address for pod in before.pods if pod.pod == "two")
    subprocess.run([*inside, "iptables", "-A", "INPUT", "-s", address, "-j", "DROP"], check=True)
    pair = tuple(sorted(machines[:2]))
    found = made.looked(lambda found: found.deaf == (pair,), f"graph in which {pair} are cut off")
    assert [f.message for f in found.errors] == [
        f"the pods on {pair[0]} and {pair[1]} do not discover each other"
    ]
    with pytest.raises(graph.GraphError) as caught:
        made.check()
    assert caught.value.exit_code == 1


def test_no_second_network(release: Callable[[str], Release], machines: list[str], namespace: str):
    """A pod whose net1 is gone turns unready; its readiness says why."""
    made = release("macvlan")
    made.attachment()
    made.node("one", machines[0])
    made.node("two", machines[1])
    made.ready("one", "two")
    inside = entering(made.cluster, namespace, "two")
    subprocess.run([*inside, "ip", "link", "delete", "net1"], check=True)
    made.unready("two")
    made.looked(lambda found: bool(found.errors), "missing interface")


def kinds(found: DiscoveryGraph) -> list[str]:
    """Return the kinds of a graph's findings."""
    return [finding.kind for finding in found.problems]


def entering(cluster: Any, namespace: str, pod: str) -> list[str]:
    """What enters a pod's network from outside; skipped where its machine is not this one."""
    uid = cluster.get(ObjectRef("v1", "Pod", namespace, pod))["metadata"]["uid"]
    for path in Path("/proc").glob("[0-9]*/cgroup"):
        try:
            if uid in path.read_text() or uid.replace("-", "_") in path.read_text():
                return ["nsenter", f"--net={path.parent}/ns/net"]
        except OSError:
            continue  # ended meanwhile
    pytest.skip("the cluster's machines are not on this one")
