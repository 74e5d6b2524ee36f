"""A ROS 1 node for tests: NAME, the topics that it publishes, the topics that it hears.

When /tmp/quiet is there, /scan stops and /diagnostics tells an error. It logs infos to errors.
"""

import os
import sys
from pathlib import Path

import rospy
from genpy.dynamic import generate_dynamic
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

QUIET = Path("/tmp/quiet")

DIAGNOSTICS = """std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: diagnostic_msgs/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
================================================================================
MSG: diagnostic_msgs/KeyValue
string key
string value
"""

TRANSFORMS = """geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


#: The base image has no packages of these messages.
TYPES = {
    **generate_dynamic("diagnostic_msgs/DiagnosticArray", DIAGNOSTICS),
    **generate_dynamic("tf2_msgs/TFMessage", TRANSFORMS),
}


def diagnostics():
    level = 2 if QUIET.exists() else 0
    status = TYPES["diagnostic_msgs/DiagnosticStatus"](level=level, name="lidar", hardware_id="a1")
    made = TYPES["diagnostic_msgs/DiagnosticArray"](status=[status])
    made.header.stamp = rospy.Time.now()
    return made


def transforms():
    stamped = TYPES["geometry_msgs/TransformStamped"](child_frame_id="laser")
    stamped.header.frame_id, stamped.header.stamp = "base", rospy.Time.now()
    return TYPES["tf2_msgs/TFMessage"](transforms=[stamped])


MESSAGES = {
    "/diagnostics": diagnostics,
    "/tf": transforms,
    "/clock": lambda: Clock(rospy.Time.now()),
}


def main():
    name, publishes, hears = sys.argv[1:4]
    Path("/tmp/pid").write_text(str(os.getpid()))
    rospy.init_node(name)
    for topic in filter(None, hears.split(",")):
        rospy.Subscriber(topic, String, lambda message: None)
    makes = {
        topic: MESSAGES.get(topic, lambda: String("x")) for topic in publishes.split(",") if topic
    }
    outs = {
        topic: rospy.Publisher(topic, type(make()), queue_size=1) for topic, make in makes.items()
    }
    rate = rospy.Rate(5)
    while not rospy.is_shutdown():
        for topic, out in outs.items():
            if topic != "/scan" or not QUIET.exists():
                out.publish(makes[topic]())
        rospy.loginfo_throttle(2, "all is well")
        rospy.logwarn_throttle(5, "a little late")
        rospy.logerr_throttle(5, "the laser is warm")
        rate.sleep()


main()
