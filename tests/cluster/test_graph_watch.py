"""An update that loses a publisher is reported, and rolled back where that is asked for."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.until import until

from .conftest import own_namespace
from .robot import Robot

pytestmark = pytest.mark.cluster

#: Publishes to a topic of its environment; on Ctrl-C and SIGTERM it ends as rospy does.
TALKER = """
import os, rospy, std_msgs.msg
rospy.init_node("talker")
topic = os.environ["TOPIC"]
publisher = rospy.Publisher(topic, std_msgs.msg.String, queue_size=10) if topic else None
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    if publisher:
        publisher.publish("hello")
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
"""
LISTENER = """
import rospy, std_msgs.msg
rospy.init_node("listener")
rospy.Subscriber("/chatter", std_msgs.msg.String, lambda message: None)
rospy.spin()
"""
LOST = "/chatter had 1 publisher, now 0"


class Talking(Robot):
    """A talker and a listener."""

    def update(self, topic: str, *, version: str = "1", check: bool = True, **more: Any) -> Any:
        """Deploy a talker that publishes a topic, none where that is empty."""
        env = {"TOPIC": topic, "VERSION": version}
        nodes = {
            "talker": {"args": ["python3", "-c", TALKER], "env": env},
            "listener": {"args": ["python3", "-c", LISTENER]},
        }
        self.write(nodes, **more)
        return self.rigel("run", "job", "deploy", "--timeout", "4m", check=check)

    def publishers(self) -> list[str]:
        """Return who publishes /chatter."""
        return self.ends()[0]

    def ends(self) -> tuple[list[str], list[str]]:
        """Return who publishes /chatter, and who subscribes to it."""
        found = json.loads(self.rigel("graph", "-o", "json", check=False).stdout)
        topics = [topic for topic in found["topics"] if topic["name"] == "/chatter"]
        return (topics[0]["publishers"], topics[0]["subscribers"]) if topics else ([], [])

    def until_talking(self) -> None:
        """Wait until both are connected: a node is ready before it has registered its topics."""
        until(
            lambda: self.ends() == (["/talker"], ["/listener"]),
            "a talker and a listener at /chatter",
            180,
            despite=(ValueError,),  # the graph cannot be read
        )

    def revisions(self) -> list[str]:
        """Return the status of each revision."""
        found = json.loads(self.rigel("history", "-o", "json").stdout)
        return [revision["status"] for revision in found]


@pytest.fixture(scope="module")
def robot(
    tmp_path_factory: pytest.TempPathFactory, base_image: str, rigel: Any, cluster: Any
) -> Iterator[Talking]:
    """A talker that publishes /chatter, and who hears it."""
    with own_namespace(cluster, "t-watch") as namespace:
        made = Talking(tmp_path_factory.mktemp("robot"), namespace, base_image, rigel, cluster)
        first = made.update("chatter")
        assert "ROS graph" not in first.stderr, "there is nothing to compare a first deploy with"
        made.until_talking()
        yield made


def test_a_harmless_update_has_nothing_to_report(robot: Talking) -> None:
    """The talker is another process, and a name of the graph as before."""
    done = robot.update("chatter", version="2")
    assert "ROS graph: as before the update" in done.stderr
    assert "warning" not in done.stderr
    again = robot.update("chatter", version="2")
    assert "ROS graph" not in again.stderr, "nothing has changed, so nothing is read"


def test_a_lost_publisher_is_rolled_back_where_that_is_asked_for(robot: Talking) -> None:
    """The error says what was worse, and the publisher is there again."""
    within = {"graph_worse": True, "within": "5s"}
    done = robot.update("", check=False, rollback_on=within)
    assert done.returncode == 1
    assert "worse than before the update: rolled back to revision 2, as revision 4" in done.stderr
    assert LOST in done.stderr
    robot.until_talking()  # the talker that is back waits until the other one has ended
    assert robot.publishers() == ["/talker"]
    assert robot.revisions()[-2:] == ["failed", "good"]
