"""The option `lifecycle` with a real lifecycle node of rclpy, in a pod of namespaces."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.support.until import until

from .conftest import SCRIPTS, Lab, Pod

pytestmark = pytest.mark.cluster

#: A lifecycle node; on_activate fails as often as its argument says.
NODE = """
import sys, rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
class Talker(LifecycleNode):
    failures = int(sys.argv[1])
    def on_configure(self, state):
        print("configured", flush=True)
        return TransitionCallbackReturn.SUCCESS
    def on_activate(self, state):
        self.failures -= 1
        print("activates", flush=True)
        fails = self.failures >= 0
        return TransitionCallbackReturn.FAILURE if fails else TransitionCallbackReturn.SUCCESS
    def on_deactivate(self, state):
        print("deactivated", flush=True)
        return TransitionCallbackReturn.SUCCESS
    def on_cleanup(self, state):
        print("cleaned up", flush=True)
        return TransitionCallbackReturn.SUCCESS
rclpy.init()
try:
    rclpy.spin(Talker("talker"))
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
PROBE = ("dds", "--domain", "0", "--transitions", "/talker")


@pytest.fixture
def talker(lab: Lab, tmp_path: Path):
    """Start the node as a deploy does; how often on_activate fails is given."""

    def start(failures: int, *transitions: str) -> Pod:
        programs = lab.venv("jazzy") / "bin"
        beside = ("/bin/sh", str(SCRIPTS / "beside.sh"), "transitions.py", "start", "/talker")
        node = ("--", "python3", "-c", NODE, str(failures))
        env = {
            "PATH": f"{programs}:{os.environ['PATH']}",
            "ROS_DOMAIN_ID": "0",
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "TMPDIR": str(tmp_path),
            "RIGEL_K8S_TRANSITIONS": "/talker deactivate cleanup",
        }
        return lab.start("talker", "one", *beside, *transitions, *node, **env)

    return start


def test_a_pod_is_ready_once_its_node_is_active(talker) -> None:
    """A transition that fails is the probe's line until it succeeds; the end is made in order."""
    pod = talker(2, "configure", "activate")
    seen: list[str] = []

    def is_ready() -> bool:
        done = pod.probe(*PROBE)
        seen.append(done.stdout.strip())
        return done.returncode == 0

    until(is_ready, "readiness", last_words=pod.log, every=0.2)
    assert seen[-1].startswith("ready: ")
    assert seen[-1].endswith(", /talker is active")
    cause = "/talker is inactive and has refused to activate (attempt 1); see its log"
    assert cause in seen
    assert pod.log().count("configured\n") == 1
    assert pod.log().count("activates\n") == 3
    done = pod.exec("/bin/sh", str(SCRIPTS / "stop.sh"), "20")
    assert done.returncode == 0
    assert pod.process.wait(30) in (0, -signal.SIGINT)
    assert pod.log().index("deactivated\n") < pod.log().index("cleaned up\n")


def test_a_node_that_stays_inactive_is_ready(talker) -> None:
    """`start` need not end in `activate`."""
    pod = talker(0, "configure")
    done = pod.probe(*PROBE, "--wait", "30")
    assert done.stdout.strip().endswith(", /talker is inactive"), pod.log()
    assert "activates" not in pod.log()
