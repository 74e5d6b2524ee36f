"""The liveness probe of real nodes with the layer, whose executors turn, wait, or stand still."""

from __future__ import annotations

import pytest

from tests.support.until import until

from .conftest import PATIENCE
from .test_keepers import keep

pytestmark = pytest.mark.cluster

#: planner.py EXECUTOR SECONDS: its one callback takes so long.
PLANNER = """
import sys, time, rclpy
from rclpy import executors
rclpy.init()
node = rclpy.create_node("planner")
executor = getattr(executors, sys.argv[1])()
executor.add_node(node)
def plan():
    timer.cancel()
    time.sleep(float(sys.argv[2]))
timer = node.create_timer(0.1, plan)
print("up", flush=True)
executor.spin()
"""


def test_a_callback_that_does_not_return_fails_the_liveness_probe(lab):
    """A node that waits for work does not, nor one whose other threads go on."""
    stuck = keep(lab, "stuck", PLANNER, "SingleThreadedExecutor", "1000")
    others = [
        keep(lab, "idle", PLANNER, "SingleThreadedExecutor", "0"),
        keep(lab, "threads", PLANNER, "MultiThreadedExecutor", "1000"),
    ]
    until(lambda: stuck.probe("stuck", "6").returncode == 1, "stuck", PATIENCE)
    assert stuck.probe("stuck", "6").stdout.startswith("/planner: no turn of its executor for ")
    assert stuck.probe("stuck", "3600").returncode == 0
    assert [one.probe("stuck", "6").stdout for one in others] == ["no executor stands still\n"] * 2


#: driver.py SECONDS: it publishes /scan for so long, then its timer is gone, and it spins on.
DRIVER = """
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("driver")
scan = node.create_publisher(String, "/scan", 1)
node.create_publisher(String, "/never", 1)
timer = node.create_timer(0.1, lambda: scan.publish(String()))
node.create_timer(float(sys.argv[1]), timer.cancel)
print("up", flush=True)
rclpy.spin(node)
"""


def test_a_driver_that_goes_silent_fails_the_liveness_probe(lab):
    """Its executor turns, so that no other probe notices it; one that publishes stays."""
    silent, lively = keep(lab, "silent", DRIVER, "1"), keep(lab, "lively", DRIVER, "1000")
    line = "/driver has published nothing on /scan for "
    until(lambda: silent.probe("stuck", "0", "/scan=3").returncode == 1, "silence", PATIENCE)
    assert silent.probe("stuck", "0", "/scan=3").stdout.startswith(line)
    assert silent.probe("stuck", "0", "/scan=3600", "/never=1").returncode == 0
    assert lively.probe("stuck", "0", "/scan=30").returncode == 0
