#!/usr/bin/env python
"""Publish numbered greetings on /chatter: `hello world NONCE N`.

N counts up by one with each message. NONCE is what the ROS parameter /nonce holds at that moment,
"none" without it: if you set it and it arrives, the message was made after that.
Parameters: ~rate, messages a second (default 10). Environment: VERSION, printed in the log.
"""

import contextlib
import os

import rospy
from std_msgs.msg import String


def main():
    rospy.init_node("talker")
    publisher = rospy.Publisher("chatter", String, queue_size=10)
    rate = rospy.Rate(rospy.get_param("~rate", 10))
    rospy.loginfo("talker version %s", os.environ.get("VERSION", "unknown"))
    number, nonce = 0, "none"
    while not rospy.is_shutdown():
        number += 1
        with contextlib.suppress(
            OSError
        ):  # the master is unreachable; the listener still receives our messages
            nonce = rospy.get_param_cached("/nonce", "none")
        message = f"hello world {nonce} {number}"
        rospy.loginfo(message)
        publisher.publish(message)
        rate.sleep()


if __name__ == "__main__":
    with contextlib.suppress(rospy.ROSInterruptException):  # asked to stop while it slept
        main()
