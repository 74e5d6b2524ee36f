"""What follows a topic and asks for parameters, with real rclpy nodes on two machines."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import pytest

from rigel_inpod.sent import LOADER, pack, read_module

from .conftest import PATIENCE, Lab, Pod

pytestmark = pytest.mark.cluster

#: A publisher of each kind, and a parameter that has a limit.
NODE = """
import array, rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rcl_interfaces.msg import SetParametersResult
from std_msgs.msg import Float64MultiArray, String
rclpy.init()
node = rclpy.create_node("talker")
node.declare_parameter("speed", 1.5)
def check(values):
    return SetParametersResult(successful=all(one.value < 10 for one in values), reason="too fast")
node.add_on_set_parameters_callback(check)
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
once = node.create_publisher(Float64MultiArray, "once", latched)
once.publish(Float64MultiArray(data=array.array("d", [0.5] * 9)))
often = node.create_publisher(
    String, "often", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
)
node.create_timer(0.1, lambda: often.publish(String(data="hello")))
print("up", flush=True)
rclpy.spin(node)
"""


@contextmanager
def running(pod: Pod, python: str, **request: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run the program in a pod with a request; its input stays open."""
    line = pod.entering([python, "-u", "-B", "-c", LOADER, json.dumps(request)])
    names = "lines", "ros2_tools"
    modules = [(name, read_module(f"rigel_inpod.sent.{name}")) for name in names]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        process.stdin.write(pack(modules))
        process.stdin.flush()
        try:
            yield process
        finally:
            process.kill()


def answer(pod: Pod, python: str, **request: Any) -> Mapping[str, Any]:
    """Return the program's first answer."""
    with running(pod, python, **request) as process:
        assert process.stdout is not None
        found: Mapping[str, Any] = json.loads(process.stdout.readline())
        return found


def test_topics_and_parameters_of_another_machines_node(lab: Lab) -> None:
    """A latched message is read, a best effort topic is heard, values are set and refused."""
    python = str(lab.venv("jazzy") / "bin" / "python")
    udp = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_DOMAIN_ID": "0"}
    lab.python("talker", "one", "jazzy", NODE, **udp)
    beside = lab.ros("beside", "two")
    echo = {"do": "echo", "publishers": 1, "field": [], "most": 4, "count": None}
    array = answer(beside, python, **echo, topic="/once", type="std_msgs/msg/Float64MultiArray")
    assert array["message"]["data"] == [0.5, 0.5, 0.5, 0.5, "..."]
    assert array["shortened"]
    often = {**echo, "topic": "/often", "type": "std_msgs/msg/String"}
    with running(beside, python, **often) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        assert json.loads(process.stdout.readline())["message"] == {"data": "hell..."}
        process.stdin.close()
        assert process.wait(PATIENCE) == 0
    count = answer(beside, python, **{**often, "do": "count"})
    assert set(count) == {"rate", "gap", "publishers"}
    missing = answer(beside, python, **{**often, "type": "no_msgs/msg/String"})
    assert (missing["error"], missing["text"]) == ("no-type", "no_msgs/msg/String")

    def call(do: str, **values: Any) -> Mapping[str, Any]:
        return answer(beside, python, do=do, node="/talker", values=values)

    assert call("get")["values"]["speed"] == 1.5
    assert call("set", speed=3)["refused"] is None
    assert call("set", speed=11)["refused"] == "too fast"
    assert call("get", speed=None)["values"] == {"speed": 3.0}
