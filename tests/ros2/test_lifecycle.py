"""The option `lifecycle` with a real lifecycle node of rclpy, in a pod of namespaces."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest

from tests.support.until import until

from .conftest import SCRIPTS, Lab, Pod

pytestmark = pytest.mark.cluster

#: A lifecycle node; on_activate fails until the file is there that its argument names.
NODE = """
import os, sys, time, rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
class Talker(LifecycleNode):
    def on_configure(self, state):
        print("configured", flush=True)
        return TransitionCallbackReturn.SUCCESS
    def on_activate(self, state):
        fails = not os.path.exists(sys.argv[1])
        print("fails" if fails else "activates", flush=True)
        return TransitionCallbackReturn.FAILURE if fails else TransitionCallbackReturn.SUCCESS
    def on_deactivate(self, state):
        print("deactivated", flush=True)
        return TransitionCallbackReturn.SUCCESS
    def on_cleanup(self, state):
        print("cleaned up", flush=True)
        return TransitionCallbackReturn.SUCCESS
rclpy.init()
time.sleep(float(os.environ.get("LATE", "0")))
try:
    rclpy.spin(Talker("talker"))
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
PROBE = ("dds", "--domain", "0", "--transitions", "/talker")


@pytest.fixture
def talker(lab: Lab, tmp_path: Path):
    """Start the node as a deploy does; on_activate fails until there is a file `well`."""

    def start(
        *transitions: str, pod: str = "talker", within: tuple[str, ...] = (), **more: str
    ) -> Pod:
        programs = lab.venv("jazzy") / "bin"
        beside = ("/bin/sh", str(SCRIPTS / "beside.sh"), "transitions.py", "start", "/talker")
        node = ("--", "python3", "-c", NODE, str(tmp_path / "well"))
        env = {
            "PATH": f"{programs}:{os.environ['PATH']}",
            "ROS_DOMAIN_ID": "0",
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "TMPDIR": str(tmp_path),
            "RIGEL_K8S_TRANSITIONS": "/talker deactivate cleanup",
            **more,
        }
        return lab.start(pod, "one", *within, *beside, *transitions, *node, **env)

    return start


def test_a_pod_is_ready_once_its_node_is_active(talker, tmp_path: Path) -> None:
    """A transition that fails is the probe's line until it succeeds; the end is made in order."""
    pod = talker("configure", "activate")
    cause = r"/talker is inactive and has refused to activate \(attempt \d+\); see its log\n"

    def has_refused() -> bool:
        done = pod.probe(*PROBE)
        return done.returncode == 1 and bool(re.fullmatch(cause, done.stdout))

    until(has_refused, "refusal in the probe's line", 120, last_words=pod.log)
    assert "has refused to activate (attempt 1); see its log\n" in pod.log()
    (tmp_path / "well").touch()
    done = pod.probe(*PROBE, "--wait", "120")
    assert done.returncode == 0, done.stdout + pod.log()
    assert done.stdout.startswith("ready: ")
    assert done.stdout.endswith(", /talker is active\n")
    assert pod.log().count("configured\n") == 1
    assert pod.log().count("activates\n") == 1
    done = pod.exec("/bin/sh", str(SCRIPTS / "stop.sh"), "60")
    assert done.returncode == 0
    assert pod.process.wait(120) in (0, -signal.SIGINT)
    assert pod.log().index("deactivated\n") < pod.log().index("cleaned up\n")


def test_a_node_that_stays_inactive_is_ready(talker, tmp_path: Path) -> None:
    """`start` need not end in `activate`."""
    (tmp_path / "well").touch()
    pod = talker("configure")
    done = pod.probe(*PROBE, "--wait", "120")
    assert done.stdout.strip().endswith(", /talker is inactive"), pod.log()
    assert "activates" not in pod.log()


def test_its_own_node_counts_while_another_pod_has_one_of_that_name(
    talker, lab: Lab, tmp_path: Path
) -> None:
    """The old one, which is active, answers too, and before the new one is there."""
    folder = lab.scripts()
    (tmp_path / "well").touch()

    def start(name: str, late: int) -> Pod:
        own = tmp_path / name
        own.mkdir()
        notes = {"RIGEL_RMW": str(own / "notes"), "RIGEL_K8S_WORKLOAD": "talker"}
        env = {"LATE": str(late), "TMPDIR": str(own), **notes}
        layer = ("/bin/sh", str(folder / "rmw.sh"))
        made = talker("configure", "activate", pod=name, within=layer, **env)
        until(lambda: "/talker is active\n" in made.log(), f"activation of {name}", 120)
        return made

    start("old", 0)
    for number in range(3):
        log = start(f"new-{number}", number).log()
        assert log.count("activates\n") == 1
        assert "refused" not in log
