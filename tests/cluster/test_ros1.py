"""ROS 1 from a Rigelfile on a real cluster: a changed master, updates, ends.

`rigel` has the rights of the Role for deployers and no others.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from tests.support.until import until

from .robot import Robot

pytestmark = pytest.mark.cluster

T = TypeVar("T")

#: A publisher and a subscriber as small as they can be; they need nothing but rospy.
TALKER = (
    "import rospy, std_msgs.msg as m; rospy.init_node('talker', anonymous={anonymous});"
    " p = rospy.Publisher('chatter', m.String, queue_size=1); r = rospy.Rate(5)\n"
    "while not rospy.is_shutdown(): p.publish('hello'); r.sleep()"
)
LISTENER = (
    "import rospy, std_msgs.msg as m; rospy.init_node('listener');"
    " rospy.Subscriber('chatter', m.String, lambda s: rospy.loginfo(s.data)); rospy.spin()"
)
PUBLISHERS = (
    "import rosgraph, sys; pubs = dict(rosgraph.Master('/test').getSystemState()[0]);"
    " print(' '.join(pubs.get('/chatter', [])))"
)


@pytest.fixture
def robot(
    tmp_path: Path, namespace: str, base_image: str, rigel_as_deployer: Any, cluster: Any
) -> Robot:
    """A robot in a namespace of its own; its `rigel` is that of a deployer."""
    return Robot(tmp_path, namespace, base_image, rigel_as_deployer, cluster)


def python(code: str) -> dict[str, Any]:
    """Return a node that runs Python code."""
    return {"args": ["python3", "-c", code]}


def talker(*, anonymous: bool = False) -> dict[str, Any]:
    """Return a talker."""
    return python(TALKER.format(anonymous=anonymous)) | ({"anonymous": True} if anonymous else {})


@contextmanager
def looking(look: Callable[[], T]) -> Iterator[list[T]]:
    """Look again and again while the body runs, and once more after it; the list is what was seen.

    A look that fails fails the test.
    """
    seen: list[T] = []
    done = threading.Event()

    def watch() -> None:
        while not done.is_set():
            seen.append(look())

    with ThreadPoolExecutor(1) as pool:
        watching = pool.submit(watch)
        try:
            yield seen
        finally:
            done.set()
        watching.result()
    seen.append(look())


def eventually(what: str, check: Callable[[], Any], seconds: float = 240) -> Any:
    """Wait for a promise to become true; fail with its words where it does not."""
    return until(check, what, seconds, every=0.5)


def signal_rospy(robot: Robot, name: str, signal: str) -> None:
    """Send a signal to the rospy process of a pod; process 1 cannot be stopped from inside."""
    robot.run(
        name,
        "sh",
        "-c",
        'for p in /proc/[0-9]*; do tr "\\0" " " <$p/cmdline | grep -q "[i]mport rospy"'
        f" && kill -{signal} ${{p#/proc/}}; done; true",
    )


@pytest.mark.slow  # in namespaces each time: tests/ros1/test_readiness.py
def test_a_stopped_process_turns_unready_and_comes_back(robot: Robot) -> None:
    """SIGSTOP leaves the pod Running; readiness sees that the node does not answer."""
    code = TALKER.format(anonymous=False)
    robot.write(
        {"talker": {"env": {"CODE": code}, "args": ["sh", "-c", 'python3 -c "$CODE"; true']}}
    )
    robot.deploy()
    signal_rospy(robot, "talker", "STOP")
    eventually("talker is NotReady", lambda: not robot.ready("talker"))
    signal_rospy(robot, "talker", "CONT")
    eventually("talker is ready again", lambda: robot.ready("talker"))


def test_a_changed_master_takes_its_nodes_along(robot: Robot) -> None:
    """Without a gate a new roscore knows nobody: its nodes start anew after it, as no orphans."""
    robot.write({"talker": talker(), "listener": python(LISTENER)}, gate=False)
    robot.deploy()
    before = robot.pods("talker")[0]["metadata"]["uid"]
    changed = {"spec": {"template": {"metadata": {"annotations": {"generation": "2"}}}}}
    robot.write(
        {"talker": talker(), "listener": python(LISTENER)},
        additional_k8s_params={"ros_master": changed},
        gate=False,
    )
    robot.deploy()
    assert robot.pods("talker")[0]["metadata"]["uid"] != before
    assert all(robot.ready(name) for name in ("ros-master", "talker", "listener"))
    assert "/talker" in robot.run("ros-master", "rosnode", "list").split()


def test_down_lets_nodes_take_leave_of_their_master(robot: Robot) -> None:
    """roscore goes last: a node that cannot unregister would use up its grace, and be killed."""
    robot.write({"talker": talker()})
    robot.deploy()
    killed: list[int] = []
    done = threading.Event()

    def watch() -> None:
        events = robot.cluster.watch(
            "v1", "Pod", robot.namespace, labels={"app.kubernetes.io/name": "talker"}, cancel=done
        )
        for event in events:
            for status in event.object["status"].get("containerStatuses", []):
                if ended := status["state"].get("terminated"):
                    killed.append(ended["exitCode"])
            if event.type == "DELETED":
                return

    watcher = threading.Thread(target=watch)
    watcher.start()
    robot.rigel("down")
    watcher.join(60)  # until it has seen all that happened before
    done.set()
    watcher.join()
    assert killed
    assert 137 not in killed


def test_a_node_that_left_the_rigelfile_is_pruned(robot: Robot) -> None:
    """The cluster follows the file: what is not in it any more is deleted, the rest untouched."""
    robot.write({"talker": talker(), "listener": python(LISTENER)})
    robot.deploy()
    kept = robot.pods("talker")[0]["metadata"]["uid"]
    robot.write({"talker": talker()})
    robot.deploy()
    assert robot.deployments() == {"ros-master", "talker"}
    assert robot.pods("talker")[0]["metadata"]["uid"] == kept


def test_an_anonymous_node_is_updated_without_a_gap(robot: Robot) -> None:
    """The new publisher is registered and ready before the old one leaves."""
    robot.write({"talker": talker(anonymous=True)})
    robot.deploy()
    robot.write({"talker": talker(anonymous=True) | {"env": {"GENERATION": 2}}})
    look = functools.partial(robot.run, "ros-master", "python3", "-c", PUBLISHERS)
    with looking(look) as seen:
        robot.deploy()
    assert len(set(seen)) > 1, "the update replaced the publisher"
    assert all(one.strip() for one in seen), "there was a publisher at every look"
