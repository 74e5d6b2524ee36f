#!/usr/bin/env python
"""Log each greeting that arrives on /chatter: `I heard hello world NONCE N`."""

import rospy
from std_msgs.msg import String


def heard(message):
    rospy.loginfo("I heard %s", message.data)


def main():
    rospy.init_node("listener")
    rospy.Subscriber("chatter", String, heard)
    rospy.spin()


if __name__ == "__main__":
    main()
