"""A Loki that is there takes our lines, and is where `rigel logs` looks: none of ours is deployed.

One is open; the other one has tenants, and wants a user and a password.
"""

from __future__ import annotations

import json
import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.names import LABELS
from rigel_lab.cluster.addons import IMAGES

from ..conftest import run_rigel, wait_for_account
from .conftest import Stack, is_ready, until

pytestmark = pytest.mark.cluster

GATEWAY = (Path(__file__).parent / "gateway.py").read_text()
LOGIN = {"username": "robots", "password": "of the lab"}
TENANT, SECRET = "lab", "their-loki"
#: Counts, and fails now and then.
TALKER = """
import rospy
rospy.init_node("talker")
number = -1
while not rospy.is_shutdown():
    number += 1
    rospy.loginfo("said %d", number)
    if number % 10 == 0:
        rospy.logerr("failed %d", number)
    rospy.sleep(0.2)
"""


def server(namespace: str, name: str, port: int, *containers: dict[str, Any]) -> Iterator[Any]:
    """Yield a pod, and the Service before it."""
    meta = {"name": name, "namespace": namespace, "labels": {"app": name}}
    ports = [{"port": port}]
    yield {"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": {"containers": containers}}
    spec = {"selector": {"app": name}, "ports": ports}
    yield {"apiVersion": "v1", "kind": "Service", "metadata": meta, "spec": spec}


#: Without it, a Loki makes other labels of what the OpenTelemetry Collector sends.
OTLP = "-distributor.otlp.default_resource_attributes_as_index_labels"


def loki(*words: str) -> dict[str, Any]:
    """Return Loki's container, as its image has it but for some words."""
    words = (*words, *(f"{OTLP}={name}" for name in [*LABELS, "level"]))
    ready = {"httpGet": {"path": "/ready", "port": 3100}, "periodSeconds": 1}
    config = "-config.file=/etc/loki/local-config.yaml"
    return {
        "name": "loki",
        "image": IMAGES["loki"],
        "args": [config, *words],
        "readinessProbe": ready,
    }


@attrs.frozen
class Theirs:
    """Their Lokis, and an application of ours that the stack sends them the lines of."""

    cluster: Any
    context: str
    namespace: str
    file: Path
    watching: Stack
    image: str

    def deploy(self, loki: dict[str, Any] | None) -> None:
        """Deploy the application with a Loki of theirs, or say nothing of any."""
        told = {"existing": {"loki": loki}} if loki else {}
        observed = {"enabled": True, "ros_metrics": False, "grafana": {"enabled": False}, **told}
        options = {
            "image": self.image,
            "ros_master_image": self.image,
            "nodes": {"talker": {"args": ["python3", "-c", TALKER]}},
            "observability": observed,
        }
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        text = {"application": {"distro": "noetic"}, "jobs": {"deploy": job}}
        self.file.write_text(json.dumps(text))
        self.rigel("run", "job", "deploy")

    def rigel(self, *words: str) -> subprocess.CompletedProcess[str]:
        place = ("--context", self.context, "-f", str(self.file), "-n", self.namespace)
        return run_rigel(*place, *words)

    def pod(self) -> str:
        """Return the talker's pod."""
        labels = {"app.kubernetes.io/name": "talker"}
        found = self.cluster.list("v1", "Pod", self.namespace, labels=labels)
        (name,) = (
            p["metadata"]["name"] for p in found if not p["metadata"].get("deletionTimestamp")
        )
        return str(name)

    def streams(self) -> list[dict[str, str]]:
        """Return the labels of the talker's streams in their open Loki."""
        query = f'{{namespace="{self.namespace}", workload="talker", level!=""}}'
        theirs = attrs.evolve(self.watching, namespace=self.namespace)
        try:
            return [one["stream"] for one in theirs.loki(query)]
        except ClusterError:  # it starts
            return []


@pytest.fixture(scope="module")
def theirs(
    cluster: Any, context: str, watching: Stack, base_image: str, tmp_path_factory: Any
) -> Iterator[Theirs]:
    """Their Lokis run, and ours is gone; in the end it is back."""
    name = f"t-theirs-{uuid.uuid4().hex[:6]}"
    words = ["python3", "-c", GATEWAY, "8080", "3100", ":".join(LOGIN.values())]
    gateway = {"name": "gateway", "image": base_image, "command": words}
    items = [
        {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}},
        *server(name, "loki", 3100, loki()),
        *server(name, "tenants", 8080, loki("-auth.enabled=true"), gateway),
    ]
    for item in items:
        cluster.apply(item)
        if item["kind"] == "Namespace":
            wait_for_account(cluster, name)
    file = tmp_path_factory.mktemp("theirs") / "Rigelfile"
    made = Theirs(cluster, context, name, file, watching, base_image)
    made.deploy({"url": f"http://loki.{name}:3100"})
    yield made
    watching.deploy({"existing": None})
    until(lambda: watching.pods("loki") and all(map(is_ready, watching.pods("loki"))), "our Loki")
    cluster.delete(ObjectRef("v1", "Secret", watching.namespace, SECRET))
    cluster.delete(ObjectRef("v1", "Namespace", "", name))


def test_their_loki_has_our_lines_with_their_labels(theirs: Theirs) -> None:
    """Application, ROS node, machine and level; and there is no Loki of ours beside it."""
    found = until(theirs.streams, "streams of the talker")
    until(lambda: {one["level"] for one in theirs.streams()} == {"info", "error"}, "both levels")
    for labels in found:
        assert labels["application"] == "rigel-k8s-application"
        assert labels["ros_node"] == "/talker"
        assert labels["pod"] == theirs.pod()
        assert labels["container"] == "ros-node"
        assert labels["node"]
    until(lambda: not theirs.watching.pods("loki"), "end of our Loki")


@pytest.fixture
def closed(theirs: Theirs) -> Callable[[str], Any]:
    """Send the lines to the Loki with tenants, and ask it from inside."""
    secret = {"name": SECRET, "namespace": theirs.watching.namespace}
    theirs.cluster.apply(
        {"apiVersion": "v1", "kind": "Secret", "metadata": secret, "stringData": LOGIN}
    )
    url = f"http://tenants.{theirs.namespace}:8080"
    theirs.deploy({"url": url, "tenant": TENANT, "secret": SECRET})

    def ask(tenant: str) -> list[Any]:
        query = "query=%7Bworkload%3D%22talker%22%7D"
        path = f"http://127.0.0.1:3100/loki/api/v1/query_range?{query}"
        get = (
            "import sys, urllib.request as r;"
            "print(r.urlopen(r.Request(sys.argv[1], headers={'X-Scope-OrgID': sys.argv[2]}))"
            ".read().decode())"
        )
        words = ["python3", "-c", get, path, tenant]
        done = theirs.cluster.run(theirs.namespace, "tenants", words, container="gateway")
        found: list[Any] = json.loads(done.stdout)["data"]["result"]
        return found

    return ask


def test_one_with_tenants_and_users_gets_the_lines(
    theirs: Theirs, closed: Callable[[str], Any]
) -> None:
    """Under the tenant that is named, past who asks for the password; `logs` reads containers."""
    found = until(lambda: closed(TENANT), "lines of the tenant")
    assert {one["stream"]["ros_node"] for one in found} == {"/talker"}
    assert closed("another") == []
    done = theirs.rigel("logs", "--since", "1h", "--tail", "1", "talker")
    assert done.stderr == ""
    assert "said" in done.stdout or "failed" in done.stdout
