"""Talkers and listeners behind a gate: pods that hand their names over, and what is heard."""

from __future__ import annotations

import re

from rigel_k8s.objects.pods import GATE_PORT, MASTER_PORT

from .conftest import WAIT

TALKER = """
import sys, time, rospy, std_msgs.msg
time.sleep(float(sys.argv[2]))
rospy.init_node("talker")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=10)
rate, number = rospy.Rate(int((sys.argv[3:] or ["20"])[0])), 0
while not rospy.is_shutdown():
    publisher.publish("%s %d" % (sys.argv[1], number))
    number += 1
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
"""
LISTENER = """
import sys, time, rospy, std_msgs.msg
rospy.init_node(sys.argv[1])
def hear(message):
    print("heard %.4f %s" % (time.time(), message.data))
for topic in sys.argv[2:]:
    rospy.Subscriber(topic, std_msgs.msg.String, hear)
rospy.spin()
"""


def hands_over(pods, workload):
    """The environment of a pod of ours whose nodes hand their names over."""
    uri = pods.master_uri.replace(str(MASTER_PORT), str(GATE_PORT))
    return {"RIGEL_K8S_WORKLOAD": workload, "ROS_MASTER_URI": uri}


def talker(pods, version, *, late=0.0, rate=20):
    """Start a talker's pod of a release of ours; it is not ready yet.

    Args:
        late: seconds before it opens ROS.
    """
    command = ("python3", "-c", TALKER, version, str(late), str(rate))
    return pods.start(f"talker-{version}", *command, env=hands_over(pods, "talker"))


def listener(pods, name="listener", topic="/chatter"):
    return pods.node(name, "python3", "-c", LISTENER, name, topic)


def ready(pod):
    done = pod.probe(*WAIT)
    assert done.returncode == 0, done.stdout + pod.log()
    return done.stdout


def heard(pod):
    """[(time, version, number)] of what a listener has heard."""
    found = re.findall(r"^heard ([\d.]+) ([-\w]+) (\d+)$", pod.log(), re.MULTILINE)
    return [(float(when), version, int(number)) for when, version, number in found]


def versions(pod):
    return [version for _, version, _ in heard(pod)]
