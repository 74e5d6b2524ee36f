"""The exporter's image beside ROS 1 and ROS 2 on a cluster, read through the API server."""

from __future__ import annotations

import json
import re
import time
import uuid
from collections.abc import Callable, Iterator
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

#: A child does the work: the first process of a container cannot be stopped.
FORKED = "import os\nchild = os.fork()\nif child: raise SystemExit(os.waitpid(child, 0)[1])\n"
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
SUBSCRIBERS = (
    "import json, rosgraph; print(json.dumps(dict(rosgraph.Master('/test').getSystemState()[1])))"
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
STOP = "kill -{} $(cat /proc/1/task/1/children)"


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

    def deploy(self, exporter: str, **ros_metrics: Any) -> str:
        """Deploy and return what was told."""
        asked = {"image": exporter, "interval": "2s", **ros_metrics}
        watched = {"enabled": True, "grafana": {"enabled": False}, "ros_metrics": asked}
        job = {**self.job, "observability": watched}
        jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
        self.file.write_text(json.dumps({"application": {"distro": self.distro}, "jobs": jobs}))
        words = ("-f", str(self.file), "run", "job", "deploy", "--timeout", "4m")
        done = run_rigel("--context", self.context, *words)
        return done.stdout + done.stderr

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
        container = {"ros-master": "ros-master-container"}.get(name)
        done = self.cluster.run(self.namespace, self.pod(name), full, container=container)
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

    def node(self, what: str, name: str, workload: str) -> float | None:
        labels = f'{{ros_node="/{name}",workload="{workload}"}}'
        return self.metrics().get(f"ros_node_{what}{labels}")


def eventually(what: str, check: Callable[[], Any], seconds: float = PATIENCE) -> Any:
    """Wait for a promise to become true; the pod may be on its way still."""
    return until(check, what, seconds, every=0.5, despite=(RigelK8sError, StopIteration))


@pytest.fixture(scope="module")
def demo(
    cluster: Any,
    context: str,
    stack: str,
    base_image: str,
    exporter_image: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Demo]:
    """The demo, deployed once for all tests of this module."""
    file = tmp_path_factory.mktemp("demo") / "Rigelfile"
    job = {
        "ros_master_image": base_image,
        "gate": False,  # a test wants a roscore that has forgotten its nodes
        "image": base_image,
        "nodes": {"talker": python(FORKED + TALKER), "listener": python(LISTENER)},
    }
    with Demo(cluster, context, file, "noetic", **job) as made:
        made.deploy(exporter_image, topics=["/chatter"])
        yield made


def test_the_demos_graph_is_told(demo: Demo) -> None:
    """Nodes with their workloads, topics, the nodes' own counts, and the exporter's own cost."""
    talker = '{ros_node="/talker",workload="talker"}'
    sent = '{ros_node="/talker",topic="/chatter",direction="published"}'
    rosout = 'ros_node_up{ros_node="/rosout",workload="ros-master"}'

    def look() -> dict[str, float] | None:
        """A scrape after which all have answered."""
        now = demo.metrics()
        counted = now.get(f"ros_node_topic_messages_total{sent}", 0) > 0
        return now if counted and now.get(f"ros_node_up{talker}") == now.get(rosout) == 1 else None

    now = eventually("the talker's messages are counted", look)
    assert now["ros_master_up{}"] == 1
    assert now["ros_master_restarts_total{}"] == 0
    assert now["ros_master_start_time_seconds{}"] > 1e9
    assert now[f"ros_node_registered{talker}"] == 1
    assert now[f"ros_node_missing_registrations{talker}"] == 0
    assert now[f"ros_node_topic_bytes_total{sent}"] > 0
    assert now['ros_topic_publishers{topic="/unnamed",type="std_msgs/String"}'] == 1
    assert now['ros_exporter_dropped{what="topics"}'] == 0
    assert now["process_cpu_seconds_total{}"] > 0
    assert now["process_resident_memory_bytes{}"] < 100e6


def test_an_unnamed_topic_has_no_subscriber_and_the_named_ones_rate_is_right(demo: Demo) -> None:
    """The master itself is asked; 10 messages a second are counted as 10."""
    name = 'ros_topic_messages_total{topic="/chatter"}'
    eventually("the named topic is heard", lambda: demo.metrics().get(name, 0) > 0)

    def rate() -> float:
        began, first = time.monotonic(), demo.metrics()[name]
        eventually("50 messages are heard", lambda: demo.metrics()[name] > first + 50)
        return (demo.metrics()[name] - first) / (time.monotonic() - began)

    # A busy machine lets the talker be late for a while; one that counts twice is never right.
    eventually("10 a second are counted as 10", lambda: rate() == pytest.approx(10, rel=0.4))
    subscribers = json.loads(demo.run("talker", "python3", "-c", SUBSCRIBERS))
    assert "/unnamed" not in subscribers
    assert sorted(subscribers["/chatter"]) == ["/listener", "/ros_exporter"]
    own = [topic for topic, names in subscribers.items() if "/ros_exporter" in names]
    assert own == ["/chatter"]
    told = demo.metrics()['ros_topic_subscribers{topic="/chatter",type="std_msgs/String"}']
    assert told == 1


def test_a_stopped_node_is_down_while_its_pod_is_there(demo: Demo) -> None:
    """SIGSTOP: registered and not answering; the others stay up."""
    demo.run("talker", "sh", "-c", STOP.format("STOP"))
    eventually(
        "the talker alone is down",
        lambda: [demo.node("up", name, name) for name in ("talker", "listener")] == [0, 1],
    )
    assert demo.node("registered", "talker", "talker") == 1
    demo.run("talker", "sh", "-c", STOP.format("CONT"))
    eventually("the talker is up", lambda: demo.node("up", "talker", "talker") == 1)


def test_a_node_that_was_started_again_is_counted(demo: Demo) -> None:
    """Its container has crashed; its pod and its address are the same."""
    assert demo.node("restarts_total", "talker", "talker") == 0
    demo.run("talker", "sh", "-c", STOP.format("KILL"))
    eventually("it is counted", lambda: demo.node("restarts_total", "talker", "talker") == 1)
    eventually("the talker is up", lambda: demo.node("up", "talker", "talker") == 1)


def test_an_expected_node_that_is_gone_is_told_as_down(demo: Demo) -> None:
    """Nobody registers it any more; the Rigelfile expects it."""
    demo.scale("listener", 0)
    eventually("the listener is down", lambda: demo.node("up", "listener", "listener") == 0)
    eventually("it left", lambda: demo.node("registered", "listener", "listener") == 0)
    demo.scale("listener", 1)
    eventually("the listener is up", lambda: demo.node("up", "listener", "listener") == 1)


def test_a_restarted_roscore_counts_and_its_orphans_are_told(demo: Demo) -> None:
    """The nodes live and are unknown; the exporter subscribes again by itself."""
    ref = ObjectRef("v1", "Pod", demo.namespace, demo.pod("ros-master"))
    demo.cluster.delete(ref)
    eventually("it is counted", lambda: demo.metrics()["ros_master_restarts_total{}"] == 1)
    eventually(
        "the talker's topics are missed",
        lambda: demo.node("missing_registrations", "talker", "talker") == 3,
    )
    assert demo.node("up", "talker", "talker") == 0
    for name in ("talker", "listener"):
        demo.cluster.delete(ObjectRef("v1", "Pod", demo.namespace, demo.pod(name)))
    for name in ("talker", "listener"):
        eventually(f"a new {name} is up", lambda name=name: demo.node("up", name, name) == 1)
    name = 'ros_topic_messages_total{topic="/chatter"}'
    first = demo.metrics()[name]
    eventually("the new talker is heard", lambda: demo.metrics()[name] > first + 10)


def test_an_application_runs_without_an_exporter_that_cannot_start(
    demo: Demo, registry: str
) -> None:
    """An image that is nowhere: the deploy says so and is good; status says so, too."""
    told = demo.deploy(f"{registry}/test/nowhere:1")
    assert re.search(r"ros-exporter is not ready: .*runs without it", told), told
    done = run_rigel("--context", demo.context, "-f", str(demo.file), "status")
    assert re.search(r"ros-exporter: .*cannot be pulled", done.stdout + done.stderr)
    assert demo.cluster.get(ObjectRef("apps/v1", "Deployment", demo.namespace, "talker"))


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
        demo.deploy(exporter_image, topics=["/chatter"])
        for name in nodes:
            eventually(f"{name} is up", lambda name=name: demo.node("up", name, name) == 1)
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
        eventually("it is gone", lambda: demo.node("up", "listener", "listener") == 0)


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
        demo.deploy(exporter_image, topics=["/chatter"])
        for name in nodes:
            eventually(f"{name} is up", lambda name=name: demo.node("up", name, name) == 1)
        heard = 'ros_topic_messages_total{topic="/chatter"}'
        eventually("the named topic is heard", lambda: demo.metrics().get(heard, 0) > 20)
        eventually("it is compared", lambda: AS_EXPECTED.items() <= demo.metrics().items())
