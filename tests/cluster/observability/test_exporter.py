"""The exporter's image beside ROS 1 and ROS 2 on a cluster, read through the API server."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.names import EXPORTER, EXPORTER_PORT
from tests.cluster.conftest import run_rigel
from tests.support.until import until

from .conftest import PATIENCE

pytestmark = pytest.mark.cluster

TALKER = (
    "import rospy, std_msgs.msg as m; rospy.init_node('talker')\n"
    "ps = [rospy.Publisher(n, m.String, queue_size=1) for n in ('/chatter', '/unnamed')]\n"
    "r = rospy.Rate(10)\n"
    "while not rospy.is_shutdown():\n for p in ps: p.publish('hello')\n r.sleep()"
)
LISTENER = (
    "import rospy, std_msgs.msg as m; rospy.init_node('listener');"
    " rospy.Subscriber('/chatter', m.String, lambda s: None); rospy.spin()"
)
TALKER_2 = (
    "import rclpy; from std_msgs.msg import String; rclpy.init(); n = rclpy.create_node('x')\n"
    "ps = [n.create_publisher(String, t, 10) for t in ('/chatter', '/unnamed')]\n"
    "n.create_timer(0.1, lambda: [p.publish(String(data='hello')) for p in ps]); rclpy.spin(n)"
)
LISTENER_2 = (
    "import rclpy; from std_msgs.msg import String; rclpy.init(); n = rclpy.create_node('x')\n"
    "n.create_subscription(String, '/chatter', lambda m: None, 10); rclpy.spin(n)"
)
COUNT_2 = (
    "import rclpy, time; rclpy.init(); n = rclpy.create_node('_count'); end = time.time() + 40\n"
    "while n.count_subscribers('/chatter') < 1 and time.time() < end: time.sleep(0.2)\n"
    "time.sleep(2); print(n.count_subscribers('/chatter'), n.count_subscribers('/unnamed'))"
)


def python(code: str) -> dict[str, Any]:
    """A node that runs Python code."""
    return {"args": ["python3", "-c", code]}


class Demo:
    """An application and its exporter in a namespace of their own."""

    def __init__(self, cluster: Any, context: str, file: Path, distro: str, **job: Any) -> None:
        self.cluster, self.context, self.file, self.distro = cluster, context, file, distro
        self.namespace = f"t-exporter-{uuid.uuid4().hex[:6]}"
        self.job = {"namespace": self.namespace, **job}

    def __enter__(self) -> Demo:
        metadata = {"name": self.namespace}
        self.cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": metadata})
        return self

    def __exit__(self, *_: object) -> None:
        self.cluster.delete(ObjectRef("v1", "Namespace", "", self.namespace))

    def deploy(self, exporter: str) -> None:
        """Deploy it, with a topic that is named."""
        asked = {"image": exporter, "interval": "2s", "topics": ["/chatter"]}
        watched = {"enabled": True, "grafana": {"enabled": False}, "ros_metrics": asked}
        job = {**self.job, "observability": watched}
        jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
        self.file.write_text(json.dumps({"application": {"distro": self.distro}, "jobs": jobs}))
        words = ("-f", str(self.file), "run", "job", "deploy", "--timeout", "4m")
        run_rigel("--context", self.context, *words)

    def pod(self, name: str) -> str:
        """The name of a workload's pod that stays."""
        labels = {"app.kubernetes.io/name": name}
        found = self.cluster.list("v1", "Pod", self.namespace, labels=labels)
        return next(
            str(p["metadata"]["name"]) for p in found if "deletionTimestamp" not in p["metadata"]
        )

    def run(self, name: str, *command: str) -> str:
        """What a command prints in a workload's pod."""
        full = ["/bin/sh", "/rigel-k8s/exec.sh", *command]
        done = self.cluster.run(self.namespace, self.pod(name), full)
        assert done.code == 0, done.stderr.decode()
        return str(done.stdout.decode())

    def scale(self, name: str, replicas: int) -> None:
        ref = ObjectRef("apps/v1", "Deployment", self.namespace, name)
        self.cluster.patch(ref, {"spec": {"replicas": replicas}})

    def metrics(self) -> dict[str, float]:
        """One scrape, as the API server passes it on: name and labels -> value."""
        ref = ObjectRef("v1", "Pod", self.namespace, f"{self.pod(EXPORTER)}:{EXPORTER_PORT}")
        text = self.cluster.get_through_proxy(ref, "metrics").decode()
        lines = (line.rpartition(" ") for line in text.splitlines() if not line.startswith("#"))
        return {name: float(value) for name, _, value in lines}

    def is_up(self, name: str) -> float | None:
        """Whether a node is, as the exporter has it."""
        labels = f'{{ros_node="/{name}",workload="{name}"}}'
        return self.metrics().get(f"ros_node_up{labels}")


def eventually(what: str, check: Callable[[], Any], seconds: float = PATIENCE) -> Any:
    """Wait for a promise to become true; the pod may be on its way still."""
    return until(check, what, seconds, every=0.5, despite=(RigelK8sError, StopIteration))


#: All of it is so, but no topic has three subscribers.
EXPECTED = {"/chatter": {"type": "std_msgs/String", "rate": "0.5..", "subscribers": "3.."}}
AS_EXPECTED = {
    f'ros_topic_as_expected{{topic="/chatter",expectation="{what}"}}': good
    for what, good in {"type": 1, "rate": 1, "subscribers": 0}.items()
}

#: The pod network of the local cluster carries no multicast between machines.
NETWORKS = {
    "peers": {"mode": "peers"},
    "macvlan": {"mode": "macvlan", "interface": "eth0", "subnet": "10.231.7.0/24"},
    "discovery-server": {"mode": "discovery-server"},
}


@pytest.mark.parametrize(
    "mode",
    [
        "macvlan",
        pytest.param("peers", marks=pytest.mark.slow),
        pytest.param("discovery-server", marks=pytest.mark.slow),
    ],
)
def test_a_ros_2_graph_is_told_on_each_network(
    cluster: Any,
    context: str,
    stack: str,
    multus: None,
    ros2_image: str,
    exporter_image: str,
    tmp_path: Path,
    mode: str,
) -> None:
    """Nodes, topics and the named topic's messages; ROS 2 itself counts no further subscriber."""
    nodes = {"talker": python(TALKER_2), "listener": python(LISTENER_2)}
    job = {"image": ros2_image, "nodes": nodes, "network": NETWORKS[mode], "expect": EXPECTED}
    with Demo(cluster, context, tmp_path / "Rigelfile", "jazzy", **job) as demo:
        demo.deploy(exporter_image)
        for name in nodes:
            eventually(f"{name} is up", lambda name=name: demo.is_up(name) == 1)
        heard = 'ros_topic_messages_total{topic="/chatter"}'
        ends = {
            'ros_topic_publishers{topic="/chatter",type="std_msgs/msg/String"}': 1,
            'ros_topic_subscribers{topic="/chatter",type="std_msgs/msg/String"}': 1,
            'ros_topic_subscribers{topic="/unnamed",type="std_msgs/msg/String"}': 0,
            **AS_EXPECTED,
        }

        def look() -> dict[str, float] | None:
            now = demo.metrics()
            return now if now.get(heard, 0) > 20 and ends.items() <= now.items() else None

        now = eventually("the named topic is heard, and all ends are known", look)
        assert not any("exporter" in name for name in now if name.startswith("ros_node"))
        assert demo.run("talker", "python3", "-c", COUNT_2).split()[-2:] == ["1", "0"]
        demo.scale("listener", 0)
        eventually("it is gone", lambda: demo.is_up("listener") == 0)


def test_a_ros_1_graph_is_told_on_a_second_network(
    cluster: Any,
    context: str,
    stack: str,
    multus: None,
    base_image: str,
    exporter_image: str,
    tmp_path: Path,
) -> None:
    """Nodes are known by addresses that only this network leads to; so is the exporter."""
    network = {"mode": "macvlan", "interface": "eth0", "subnet": "10.231.8.0/24", "ipam": "static"}
    nodes = {"talker": python(TALKER), "listener": python(LISTENER)}
    job = {"ros_master_image": base_image, "image": base_image, "nodes": nodes, "network": network}
    job["expect"] = EXPECTED
    with Demo(cluster, context, tmp_path / "Rigelfile", "noetic", **job) as demo:
        demo.deploy(exporter_image)
        for name in nodes:
            eventually(f"{name} is up", lambda name=name: demo.is_up(name) == 1)
        heard = 'ros_topic_messages_total{topic="/chatter"}'
        eventually("the named topic is heard", lambda: demo.metrics().get(heard, 0) > 20)
        eventually("it is compared", lambda: AS_EXPECTED.items() <= demo.metrics().items())
