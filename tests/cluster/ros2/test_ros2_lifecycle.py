"""A node with `lifecycle` on a real cluster: a transition that fails is the cause."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.until import until

pytestmark = pytest.mark.cluster

#: A lifecycle node that can be configured, but not activated.
NODE = """
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
class Driver(LifecycleNode):
    def on_activate(self, state):
        return TransitionCallbackReturn.FAILURE
rclpy.init()
try:
    rclpy.spin(Driver("driver"))
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


def test_a_transition_that_fails_is_the_cause(
    tmp_path: Path, namespace: str, ros2_image: str, rigel: Any
) -> None:
    """The deploy fails with it, and `rigel status` says it; the transition before it was made."""
    node = {
        "args": ["python3", "-c", NODE],
        "namespace": "robot1",
        "lifecycle": {"start": ["configure", "activate"], "stop": ["cleanup"]},
    }
    options = {"image": ros2_image, "network": "peers", "nodes": {"driver": node}}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    file = tmp_path / "Rigelfile"
    file.write_text(json.dumps({"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}))
    place = ("-f", str(file), "-n", namespace)
    cause = "/robot1/driver is inactive and has refused to activate (attempt "

    def deploy() -> bool:
        """Whether a deploy fails with this cause; on a busy machine the node may not run yet."""
        done = rigel(*place, "run", "job", "deploy", "--timeout", "20s", check=False)
        assert done.returncode != 0
        return cause in done.stdout + done.stderr

    until(deploy, cause, 180)
    until(lambda: cause in rigel(*place, "status", check=False).stdout, f"{cause} in the status")
