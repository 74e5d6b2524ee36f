"""A ROS 2 node for tests: /scan five times a second, and each level in its log every two.

When /tmp/quiet is there it says nothing on /scan. What it hears, /cmd_vel, nobody publishes.
"""

import os
import traceback
from pathlib import Path

import rclpy
from std_msgs.msg import String

QUIET = Path("/tmp/quiet")
EACH = 10


def main():
    Path("/tmp/pid").write_text(str(os.getpid()))
    rclpy.init()
    node = rclpy.create_node("lidar")
    scan = node.create_publisher(String, "/scan", 10)
    node.create_subscription(String, "/cmd_vel", lambda message: None, 10)
    turns = iter(range(10**9))

    def turn():
        if not QUIET.exists():
            scan.publish(String(data="x"))
        if next(turns) % EACH == 0:
            report(node.get_logger())

    node.create_timer(0.2, turn)
    rclpy.spin(node)


def report(log):
    log.debug("its mirror turns")
    log.info("all is well")
    log.warning("a little late")
    try:
        [][EACH]
    except IndexError:
        log.error("a ray is lost\n" + traceback.format_exc().rstrip())
    log.fatal("the laser is burnt")


main()
