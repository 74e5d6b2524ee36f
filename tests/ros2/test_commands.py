"""The small `ros2` of our base image looks at a graph of real rclpy nodes."""

from __future__ import annotations

import time
from importlib import resources
from pathlib import Path

import pytest

from .conftest import Lab

pytestmark = pytest.mark.cluster

ROS2 = str(resources.files("rigel_lab") / "images" / "ros2base" / "files" / "ros2")


#: A node that begins when it is told to: until then a busy machine has loaded its program.
LATE = """
import os, sys, time, rclpy
print("up", flush=True)
while not os.path.exists(sys.argv[1]):
    time.sleep(0.05)
rclpy.init()
rclpy.spin(rclpy.create_node("late"))
"""
ENV = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["topic", "info", "/rosout"], "Publisher count: 1"),
        (["param", "get", "/late", "use_sim_time"], "Boolean value is: False"),
    ],
    ids=["topic", "param"],
)
def test_a_command_waits_for_what_it_names(
    lab: Lab, tmp_path: Path, words: list[str], told: str
) -> None:
    """Also if discovery takes longer than --spin-time; here the node begins only then."""
    python = str(lab.venv("jazzy") / "bin" / "python")
    begin = tmp_path / "begin"
    lab.python("late", "two", "jazzy", LATE, str(begin), **ENV)
    asks = lab.start("asks", "one", python, "-B", ROS2, *words, **ENV)
    time.sleep(4.5)  # --spin-time is three seconds
    assert asks.process.poll() is None, asks.log()
    begin.touch()
    assert asks.process.wait(timeout=120) == 0, asks.log()
    assert told in asks.log()
