"""The readiness probe against real rospy and roscpp nodes and a real roscore."""

from __future__ import annotations

import signal
from collections.abc import Callable

import pytest

pytestmark = pytest.mark.cluster

RELAY = ("rosrun", "topic_tools", "relay", "/in", "/out")
TALKER = """#!/usr/bin/env python
import sys
import rospy
from std_msgs.msg import String
rospy.init_node(sys.argv[1], anonymous="--anonymous" in sys.argv)
publisher = rospy.Publisher(sys.argv[1] + "_topic", String, queue_size=1)
rate = rospy.Rate(10)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rate.sleep()
"""
FILES = {"/talker.py": TALKER}


def test_fixed_name(pods):
    """A rospy node with a fixed name is ready once it is registered from this pod."""
    pods.master()
    pod = pods.node("talker", "/talker.py", "talker", files=FILES)
    assert pod.probe().stdout == "ready: /talker\n"
