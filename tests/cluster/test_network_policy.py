"""`network_policy`: who reaches the pods of a release where the network enforces policies."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from tests.support.policies import enforced
from tests.support.until import until

from .conftest import own_namespace
from .robot import Robot

pytestmark = pytest.mark.cluster

TALKER = (
    "import rospy, std_msgs.msg as m; rospy.init_node('talker');"
    " p = rospy.Publisher('chatter', m.String, queue_size=1); r = rospy.Rate(5)\n"
    "while not rospy.is_shutdown(): p.publish('hello'); r.sleep()"
)
LISTENER = (
    "import time, rospy, std_msgs.msg as m; rospy.init_node('listener');"
    " rospy.Subscriber('chatter', m.String, lambda s: print('heard %.3f' % time.time()));"
    " rospy.spin()"
)
NODES: dict[str, Any] = {
    "talker": {"args": ["python3", "-c", TALKER], "placement": {"apart_from": ["listener"]}},
    "listener": {"args": ["python3", "-c", LISTENER]},
}
#: Connects to ADDRESS PORT for two seconds.
CONNECT = (
    "import socket, sys\n"
    "try: socket.create_connection((sys.argv[1], int(sys.argv[2])), 2); print('reached')\n"
    "except OSError as error: print(error)"
)


class Stranger(Robot):
    """A program of another release, beside the robot or in a namespace of its own."""

    def reaches(self, pod: dict[str, Any], port: int) -> bool:
        """Return whether it can connect to a port of a pod."""
        words = ("python3", "-c", CONNECT, pod["status"]["podIP"], str(port))
        said = self.run("stranger", *words).strip()
        assert said in ("reached", "timed out"), said
        return said == "reached"


@pytest.fixture
def elsewhere(cluster: Any) -> Iterator[str]:
    """Another namespace, deleted after the test."""
    with own_namespace(cluster, "t") as name:
        yield name


def deploy_stranger(
    directory: Path, namespace: str, image: str, rigel: Any, cluster: Any
) -> Stranger:
    """Deploy a release `stranger`, a program that waits."""
    directory.mkdir()
    made = Stranger(directory, namespace, image, rigel, cluster)
    node = {"ros": "none", "args": ["sleep", "infinity"]}
    made.write({"stranger": node}, deployment_name="stranger", deploy_ros_master=False)
    made.deploy()
    return made


def count_heard(robot: Robot) -> int:
    """Return how many messages the listener has heard."""
    return str(robot.rigel("logs", "listener").stdout).count("heard ")


def ports_of(robot: Robot) -> list[tuple[dict[str, Any], int]]:
    """Return the ports at which others connect: the master's, the gate's, the talker's own."""
    [master], [talker] = robot.pods("ros-master"), robot.pods("talker")
    uri = robot.run("talker", "python3", "-c", LOOKUP).strip()
    return [(master, 11311), (master, 11310), (talker, int(uri.rstrip("/").rpartition(":")[2]))]


LOOKUP = "import rosgraph; print(rosgraph.Master('/t').lookupNode('/talker'))"


def test_only_the_releases_own_pods_and_those_allowed_reach_it(
    tmp_path: Path,
    namespace: str,
    elsewhere: str,
    base_image: str,
    rigel: Any,
    cluster: Any,
    context: str,
) -> None:
    """Without the key all reach the nodes; with it strangers do not, and ROS, probes, rigel do."""
    name = context.removeprefix("rigel-")
    if not Path(f"/run/netns/rigel-{name}-node1").exists():
        pytest.skip("only the machines of a local cluster can be made to enforce policies")
    robot = Robot(tmp_path, namespace, base_image, rigel, cluster)
    robot.write(NODES)
    robot.deploy()
    place = (base_image, rigel, cluster)
    beside = deploy_stranger(tmp_path / "beside", namespace, *place)
    far = deploy_stranger(tmp_path / "far", elsewhere, *place)
    with enforced(cluster, name):
        ports = ports_of(robot)
        assert all(one.reaches(*port) for one in (beside, far) for port in ports)

        before = [pod["metadata"]["uid"] for pod in robot.pods("talker")]
        robot.write(NODES, network_policy=True)
        robot.deploy()
        assert [pod["metadata"]["uid"] for pod in robot.pods("talker")] == before
        until(
            lambda: not any(far.reaches(*port) for port in ports),
            "the policy to be enforced on all machines",
            180,
        )
        assert not any(beside.reaches(*port) for port in ports)

        cluster.delete(
            ObjectRef("v1", "Pod", namespace, robot.pods("talker")[0]["metadata"]["name"])
        )
        until(lambda: robot.ready("talker"), "a new talker is ready", 240)
        heard = count_heard(robot)
        until(lambda: count_heard(robot) > heard, "the listener hears the new talker", 180)
        assert "/chatter" in robot.rigel("graph").stdout
        assert "/talker" in robot.run("ros-master", "rosnode", "list")

        robot.write(NODES, network_policy={"allow": ["stranger", f"{elsewhere}/*"]})
        robot.deploy()
        until(lambda: beside.reaches(*ports[0]), "the allowed release reaches the master", 180)
        until(lambda: far.reaches(*ports[0]), "the allowed namespace reaches the master", 180)
