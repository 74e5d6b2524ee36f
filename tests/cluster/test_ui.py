"""`rigel ui` on a real release, in a real browser."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.support.axe import find_violations
from tests.support.browser import Browser, Tab, find_program, run_browser

from .conftest import own_namespace
from .robot import Robot

pytestmark = [pytest.mark.cluster, pytest.mark.story]

#: Publishes and logs.
TALKER = """
import rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("/chatter", std_msgs.msg.String, queue_size=10)
count = 0
while not rospy.is_shutdown():
    publisher.publish("hello")
    count += 1
    if count % 5 == 0:
        rospy.loginfo("hello %d <b>", count)
    rospy.rostime.wallsleep(0.1)
"""
LISTENER = """
import rospy, std_msgs.msg
rospy.init_node("listener")
rospy.Subscriber("/chatter", std_msgs.msg.String, lambda message: None)
rospy.spin()
"""


class Talking(Robot):
    """A talker and a listener."""

    def update(self, version: str) -> None:
        """Deploy a version."""
        talker = {"args": ["python3", "-c", TALKER], "env": {"VERSION": version}}
        self.write({"talker": talker, "listener": {"args": ["python3", "-c", LISTENER]}})
        self.rigel("run", "job", "deploy", "--timeout", "4m")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if find_program() is None:
        pytest.skip("Chromium is not installed")
    with run_browser() as made:
        yield made


@pytest.fixture(scope="module")
def robot(
    tmp_path_factory: pytest.TempPathFactory, base_image: str, rigel: Any, cluster: Any
) -> Iterator[Talking]:
    with own_namespace(cluster, "t-ui") as namespace:
        made = Talking(tmp_path_factory.mktemp("robot"), namespace, base_image, rigel, cluster)
        made.update("1")
        yield made


@contextmanager
def rigel_ui(*words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run `rigel ui`; give the address and the process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "rigel_k8s", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    assert process.stderr
    try:
        yield process.stdout.readline().strip(), process
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=120)
        assert (process.returncode, told) == (0, "Press Ctrl-C to end.\n")
    finally:
        process.kill()
        process.wait(30)
        process.stdout.close()
        process.stderr.close()


@pytest.fixture(scope="module")
def ui(robot: Talking, context: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """`rigel ui` of the robot, with changes allowed."""
    place = ("--context", context, "-f", str(robot.file), "-n", robot.namespace)
    with rigel_ui(*place, "ui", "--no-browser", "--allow-changes") as made:
        yield made


@pytest.fixture(scope="module")
def tab(browser: Browser, ui: tuple[str, Any]) -> Iterator[Tab]:
    """One page, open all the time."""
    made = browser.open()
    made.resize(1440, 1000)
    made.go(ui[0])
    yield made
    assert made.complaints() == []
    made.close()


def box(name: str, state: str) -> str:
    return f"document.querySelector('[data-box=\"{name}\"].{state}')"


def revision(number: int) -> str:
    return f"document.querySelector('#revision').textContent === 'Revision {number}, good'"


def click(tab: Tab, selector: str) -> None:
    tab.read(
        f"document.querySelector('{selector}')"
        ".dispatchEvent(new MouseEvent('click', {bubbles: true}))"
    )


def test_nodes_are_shown_on_their_machines_with_topics(tab: Tab, robot: Talking) -> None:
    """As the cluster and the ROS graph have them."""
    for name in ("/talker", "/listener"):
        tab.wait(box(name, "ready"), f"{name}, ready")
    machines = {pod["spec"]["nodeName"] for n in ("talker", "listener") for pod in robot.pods(n)}
    shown = tab.read("[...document.querySelectorAll('.machine text')].map((t) => t.textContent)")
    assert set(shown) == machines
    tab.wait("document.querySelector('[data-topic=\"/chatter\"]')", "the topic")
    # A node is ready before it has registered its topics; the graph is read every half minute.
    tab.wait("document.querySelectorAll('.edge').length === 2", "both ends of the topic", 180)
    assert len(tab.read("[...document.querySelectorAll('.edge')].map((e) => e.tagName)")) == 2
    tab.wait(revision(1), "the revision")
    assert find_violations(tab) == []


def test_the_log_is_live(tab: Tab) -> None:
    """What the node says now appears below what it has said."""
    click(tab, '[data-box="/talker"]')
    lines = "document.querySelectorAll('#log .line.info').length"
    tab.wait(f"{lines} > 0", "lines")
    before = tab.read(lines)
    tab.wait(f"{lines} > {before}", "more lines")
    assert "hello 5 <b>" in tab.read("document.querySelector('#log').textContent")
