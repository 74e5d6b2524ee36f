"""An update of a lifecycle node on two machines: never do two work, and nothing is lost."""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from tests.support.until import until

from .conftest import apart

pytestmark = pytest.mark.cluster

#: Says its version and counts, 20 times a second; a broken one cannot be configured.
TALKER = """
import os, rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String
class Talker(LifecycleNode):
    number = 0
    def on_configure(self, state):
        if os.environ["VERSION"] == "broken":
            return TransitionCallbackReturn.FAILURE
        self.publisher = self.create_lifecycle_publisher(String, "chatter", 100)
        return super().on_configure(state)
    def on_activate(self, state):
        self.timer = self.create_timer(0.05, self.say)
        return super().on_activate(state)
    def on_deactivate(self, state):
        self.destroy_timer(self.timer)
        return super().on_deactivate(state)
    def say(self):
        self.publisher.publish(String(data="%s %d" % (os.environ["VERSION"], self.number)))
        self.number += 1
rclpy.init()
try:
    rclpy.spin(Talker("talker"))
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
LISTENER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(String, "chatter", lambda m: print("heard", m.data, flush=True), 100)
rclpy.spin(node)
"""
HEARD = re.compile(r"^heard (\w+) (\d+)$", re.MULTILINE)


class Talking:
    """A talker and a listener on two machines; the talker is a lifecycle node."""

    def __init__(
        self, file: Path, namespace: str, image: str, network: Any, rigel: Any, cluster: Any
    ) -> None:
        self.file, self.namespace, self.image = file, namespace, image
        self._rigel, self.cluster = rigel, cluster
        self.network = network

    def rigel(self, *words: str, check: bool = True) -> Any:
        """Run rigel on the Rigelfile."""
        return self._rigel("-f", str(self.file), "-n", self.namespace, *words, check=check)

    def update(self, version: str, *, timeout: str = "4m", check: bool = True) -> Any:
        """Deploy the talker in a version."""
        nodes = {
            "talker": {
                "args": ["python3", "-c", TALKER],
                "env": {"VERSION": version},
                "placement": {"apart_from": ["listener"]},
                "update": {"strategy": "HandOver"},
            },
            "listener": {"args": ["python3", "-c", LISTENER]},
        }
        options = {"image": self.image, "network": self.network, "nodes": nodes}
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
        self.file.write_text(json.dumps(whole))
        return self.rigel("run", "job", "deploy", "--timeout", timeout, check=check)

    def heard(self) -> list[tuple[str, int]]:
        """Return (version, number) of what the listener has heard."""
        text = self.rigel("logs", "listener").stdout
        return [(version, int(number)) for version, number in HEARD.findall(text)]

    def until_heard(self, version: str, number: int = 0) -> None:
        """Wait until the listener hears a version, from a number on."""

        def has_come() -> bool:
            last, count = ([("", 0), *self.heard()])[-1]
            return last == version and count >= number

        until(has_come, f"{version} {number}", 120, every=0.5)


@pytest.fixture(
    params=["macvlan", pytest.param("discovery-server", marks=pytest.mark.slow)],
)
def network(request: pytest.FixtureRequest) -> dict[str, Any]:
    """The networks on which a node may hand over; docs/whole-robot.md has the second."""
    if request.param == "discovery-server":
        return {"mode": "discovery-server", "servers": 2}
    request.getfixturevalue("multus")
    return {"mode": "macvlan", "interface": "eth0", **apart(ros1=False)}


@pytest.fixture
def talking(
    tmp_path: Path, ros2_image: str, network: dict[str, Any], rigel: Any, cluster: Any
) -> Iterator[Talking]:
    """The talker in version v1, heard."""
    namespace = f"t-take-{uuid.uuid4().hex[:6]}"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": namespace}})
    made = Talking(tmp_path / "Rigelfile", namespace, ros2_image, network, rigel, cluster)
    made.update("v1")
    made.until_heard("v1")
    yield made
    cluster.delete(ObjectRef("v1", "Namespace", "", namespace))


def test_a_lifecycle_node_is_handed_over(talking: Talking) -> None:
    """A newcomer that cannot be configured changes nothing; one that can takes over.

    No message of the old one comes after the new one's first, and none twice. The old one was
    deactivated and not cut off: all that it has sent has come.
    """
    assert talking.update("broken", timeout="6s", check=False).returncode == 1
    refused = "/talker has refused to configure"
    until(lambda: refused in talking.rigel("logs", "talker").stdout, refused, 120, every=0.5)
    version, number = talking.heard()[-1]
    talking.until_heard(version, number + 20)
    assert version == "v1"
    talking.update("v2")
    talking.until_heard("v2", 20)
    found = talking.heard()
    versions = [version for version, _ in found]
    assert versions == sorted(versions)
    assert set(versions) == {"v1", "v2"}
    for version in ("v1", "v2"):
        numbers = [number for one, number in found if one == version]
        assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert found[versions.index("v2")] == ("v2", 0)
