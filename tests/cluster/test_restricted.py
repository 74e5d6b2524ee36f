"""`security: restricted` where Kubernetes enforces it: images that run as root by default work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.objects.refs import ObjectRef
from tests.support.until import until

from .robot import Robot

pytestmark = pytest.mark.cluster

TALKER = (
    "import os, rospy, std_msgs.msg as m; rospy.init_node('talker');"
    " p = rospy.Publisher('chatter', m.String, queue_size=1); r = rospy.Rate(5)\n"
    "while not rospy.is_shutdown(): p.publish(os.environ['VERSION']); r.sleep()"
)
LISTENER = (
    "import rospy, std_msgs.msg as m; rospy.init_node('listener');"
    " rospy.Subscriber('chatter', m.String, lambda s: rospy.loginfo('heard ' + s.data));"
    " rospy.spin()"
)
TALKER2 = (
    "import sys, rclpy, std_msgs.msg as m; rclpy.init(args=sys.argv);"
    " n = rclpy.create_node('talker'); p = n.create_publisher(m.String, 'chatter', 1);"
    " n.create_timer(0.2, lambda: p.publish(m.String(data='v1'))); rclpy.spin(n)"
)
LISTENER2 = (
    "import sys, rclpy, std_msgs.msg as m; rclpy.init(args=sys.argv);"
    " n = rclpy.create_node('listener');"
    " n.create_subscription(m.String, 'chatter',"
    " lambda s: n.get_logger().info('heard ' + s.data), 1); rclpy.spin(n)"
)
STORAGE = {"volumes": [{"name": "maps", "size": "10Mi"}]}
ENFORCE = {"metadata": {"labels": {"pod-security.kubernetes.io/enforce": "restricted"}}}


@pytest.fixture
def restricted(namespace: str, cluster: Any) -> str:
    """A namespace where Kubernetes enforces the level."""
    url = cluster.client.path_of(ObjectRef("v1", "Namespace", "", namespace), "label")
    media = "application/merge-patch+json"
    cluster.client.call("PATCH", url, "label", read_mapping, body=ENFORCE, media=media)
    return namespace


def python(code: str, **env: str) -> dict[str, Any]:
    """Return a node that runs Python code."""
    return {"args": ["python3", "-c", code], "env": env}


def stored(node: dict[str, Any]) -> dict[str, Any]:
    """Return a node that has a claim."""
    return node | {"volumes": [{"name": "maps", "mount_path": "/maps"}]}


def until_heard(robot: Robot, text: str) -> None:
    """Wait until the listener has logged a message."""
    until(
        lambda: f"heard {text}" in robot.rigel("logs", "listener").stdout, f"{text} is heard", 180
    )


def until_measured(robot: Robot, topic: str) -> None:
    """Wait until the exporter has counted messages of a topic."""
    [pod] = robot.pods("ros-exporter")
    ref = ObjectRef("v1", "Pod", robot.namespace, f"{pod['metadata']['name']}:9419")
    counted = f'ros_topic_messages_total{{topic="{topic}"'

    def measured() -> bool:
        text = robot.cluster.get_through_proxy(ref, "metrics").decode()
        lines = (line for line in text.splitlines() if line.startswith(counted))
        return any(float(line.rpartition(" ")[2]) > 0 for line in lines)

    until(measured, f"messages of {topic} in the exporter", 180)


def exported(image: str) -> dict[str, Any]:
    """Return the options of an exporter without a stack: a deployer may not install that."""
    ros_metrics = {"image": image, "interval": "2s", "topics": ["/chatter"]}
    return {"enabled": True, "collector": "promtail", "ros_metrics": ros_metrics}


def test_ros1_works_and_hands_over(
    tmp_path: Path,
    restricted: str,
    base_image: str,
    exporter_image: str,
    rigel_as_deployer: Any,
    cluster: Any,
) -> None:
    """roscore, its gate, nodes and the exporter run without root; roscore's log is written."""
    robot = Robot(tmp_path, restricted, base_image, rigel_as_deployer, cluster)
    options = {
        "security": "restricted",
        "persistent_storage": STORAGE,
        "observability": exported(exporter_image),
    }
    for version in ("v1", "v2"):
        nodes = {"talker": python(TALKER, VERSION=version), "listener": stored(python(LISTENER))}
        robot.write(nodes, **options)
        robot.deploy()
        until_heard(robot, version)
    until_measured(robot, "/chatter")
    assert "/talker" in robot.run("ros-master", "sh", "-c", "cat ~/.ros/log/latest/master.log")
    assert robot.run("listener", "sh", "-c", "id -u; touch /maps/file /tmp/file ~/file") == "1000\n"
    [talker] = cluster.list(
        "apps/v1", "Deployment", restricted, labels={"app.kubernetes.io/name": "talker"}
    )
    assert talker["spec"]["strategy"]["type"] == "RollingUpdate"
    refused = robot.rigel("join", "--", "true", check=False)
    assert refused.returncode == 1
    assert "forbids a pod that may send frames" in refused.stderr
    assert "hint: without that, connect single ports with `rigel forward`" in refused.stderr


def test_ros2_hears_an_unrestricted_driver_of_another_namespace(
    tmp_path: Path, restricted: str, ros2_image: str, rigel: Any, cluster: Any
) -> None:
    """As docs/security.md describes it: one domain, and the driver's job lists the other's node."""
    drivers = f"{restricted}-drivers"
    network = {"mode": "peers", "domain_id": 97}
    robot = {
        "namespace": restricted,
        "security": "restricted",
        "image": ros2_image,
        "network": network,
        "nodes": {"listener": python(LISTENER2)},
    }
    driver = {
        "namespace": drivers,
        "deployment_name": "drivers",
        "image": ros2_image,
        "network": {**network, "peers": [f"listener-peer.{restricted}"]},
        "nodes": {"talker": {**python(TALKER2), "security_context": {"privileged": True}}},
    }
    plugin = "rigel_k8s.OrchestrationPlugin"
    jobs = {n: {"plugin": plugin, "with": w} for n, w in (("robot", robot), ("driver", driver))}
    file = tmp_path / "Rigelfile"
    file.write_text(json.dumps({"application": {"distro": "jazzy"}, "jobs": jobs}))
    try:
        for job in jobs:
            rigel("-f", str(file), "run", "job", job, "--timeout", "5m")
        place = ("-f", str(file), "-n", restricted)
        until(
            lambda: "heard v1" in rigel(*place, "logs", "listener").stdout,
            "the driver is heard",
            180,
        )
    finally:
        cluster.delete(ObjectRef("v1", "Namespace", "", drivers))
