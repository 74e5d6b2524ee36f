"""roscore as our manifests start it: it hears of the dead and still tells the living."""

from __future__ import annotations

import pytest

from rigel_k8s.app.generations.ros1.master import ROSCORE

pytestmark = pytest.mark.cluster

SPIN = """#!/usr/bin/env python
import sys
import rospy
rospy.init_node(sys.argv[1])
rospy.spin()
"""
LISTENER = """#!/usr/bin/env python
import rospy
from std_msgs.msg import String
rospy.init_node("listener")
rospy.Subscriber("late", String, lambda m: print("heard", m.data, flush=True))
rospy.spin()
"""
TALKER = """#!/usr/bin/env python
import rospy
from std_msgs.msg import String
rospy.init_node("talker")
publisher = rospy.Publisher("topic", String, queue_size=1)
rate = rospy.Rate(5)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rate.sleep()
"""


def test_replaced_pods_do_not_keep_the_master_from_telling_others(pods, eventually):
    """As many pods as roscore has threads by default vanish and are replaced under their names."""
    pods.roscore()
    for name in ("one", "two", "three", "four"):
        files = {"/spin.py": SPIN}
        old = pods.node(name, "python3", "/spin.py", name, files=files)
        pods.iptables(old, "-I", "INPUT", "-j", "DROP")  # as an address that no pod has
        old.kill()
        pods.node(f"{name}-again", "python3", "/spin.py", name, files=files)
    listener = pods.node("listener", "python3", "/listen.py", files={"/listen.py": LISTENER})
    pods.node("talker", "python3", "/talk.py", "topic:=late", files={"/talk.py": TALKER})
    eventually(lambda: "heard hello" in listener.log(), "the listener was told of the talker")


def test_a_node_that_was_silent_for_long_is_told_all_the_same(pods, eventually):
    """roscore closes idle connections; roscpp and rospy open them again."""
    pods.roscore()
    relay = pods.node("relay", "/usr/lib/topic_tools/relay", "/topic", "/late", "__name:=relay")
    listener = pods.node("listener", "python3", "/listen.py", files={"/listen.py": LISTENER})
    idle = float(ROSCORE[ROSCORE.index("-t") + 1]) * 2
    relay.exec("sleep", str(idle))
    pods.node("talker", "python3", "/talk.py", files={"/talk.py": TALKER})
    eventually(lambda: "heard hello" in listener.log(), "the relay was told of the talker")
