"""`rigel ui` on a real release, in a real browser."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.axe import find_violations
from tests.support.browser import Browser, Tab, find_program, run_browser
from tests.support.until import until

from .conftest import own_namespace
from .rights import grant_role, write_impersonation
from .robot import Robot

pytestmark = [pytest.mark.cluster, pytest.mark.story]

VIEWER = "rigel-test-viewer"
#: Publishes, logs, and ends badly when a file appears.
TALKER = """
import os, sys, rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("/chatter", std_msgs.msg.String, queue_size=10)
count = 0
while not rospy.is_shutdown():
    if os.path.exists("/tmp/crash"):
        sys.exit("the device is gone")
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


def test_a_crashing_node_turns_red_and_has_its_cause(tab: Tab, robot: Talking) -> None:
    """Its place and its topics stay; its log has its last words."""
    places = "JSON.stringify([...document.querySelectorAll('.box')].map((b) => [b.dataset.box,"
    places += (
        " b.querySelector('rect').getAttribute('x'), b.querySelector('rect').getAttribute('y')]))"
    )
    before = tab.read(places)
    robot.run("talker", "touch", "/tmp/crash")
    tab.wait(box("/talker", "crashed"), "a crashed talker")
    assert "exited with code 1" in tab.read("document.querySelector('#details').textContent")
    assert tab.read(places) == before
    assert tab.read("document.title").startswith("✖ 1")
    assert "/talker is crashed" in tab.read("document.querySelector('#announcer').textContent")
    log = "document.querySelector('#log').textContent"
    tab.wait(f"{log}.includes('the device is gone')", "its last words")


def test_ten_pages_ask_the_cluster_no_more_than_one(
    browser: Browser, ui: tuple[str, subprocess.Popen[str]], tab: Tab, robot: Talking
) -> None:
    """One set of watches, and one follow of the log that the page in front shows."""
    [pod] = robot.pods("talker")
    line = f"document.querySelector('#log .line[title=\"{pod['metadata']['name']}\"]')"
    tab.wait(line, "its log")
    before = connections_of(ui[1].pid)
    tabs = []
    for _ in range(9):
        tabs.append(browser.open(f"{ui[0]}#node=talker"))
        tabs[-1].show()
        tabs[-1].wait(box("/talker", "ready"), "the talker")
        tabs[-1].wait("document.querySelector('#log .line')", "its log")
    assert len(before) > 5
    # A reading of the ROS graph, every half minute, has a connection of its own.
    until(lambda: len(connections_of(ui[1].pid)) <= len(before), "no more connections", 120)
    for one in tabs:
        one.close()


def connections_of(pid: int) -> set[str]:
    """Return the connections of a process that lead out of it: to the API server."""
    own = {name_of(link) for link in Path(f"/proc/{pid}/fd").iterdir()}
    rows = Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]
    fields = [row.split() for row in rows]
    listening = {f[1].split(":")[1] for f in fields if f[3] == "0A" and f"socket:[{f[9]}]" in own}
    return {
        f[1]
        for f in fields
        if f"socket:[{f[9]}]" in own and f[3] == "01" and f[1].split(":")[1] not in listening
    }


def name_of(link: Path) -> str:
    try:
        return link.readlink().name
    except OSError:  # it has just been closed
        return ""


def test_a_viewer_sees_nodes_and_logs(
    browser: Browser, robot: Talking, admin: Any, context: str, tmp_path: Path
) -> None:
    """With the Role for viewers: without topics and revisions, and the page says why."""
    grant_role(admin, robot.namespace, "viewer", VIEWER)
    file = write_impersonation(context, VIEWER, tmp_path)
    place = ("-f", str(robot.file), "-n", robot.namespace, "--kubeconfig", str(file))
    with rigel_ui(*place, "ui", "--no-browser") as (address, _):
        tab = browser.open(f"{address}#node=talker")
        tab.wait(box("/talker", "ready"), "the talker")
        tab.wait("document.querySelector('#log .line')", "its log")
        tab.wait("document.querySelector('#history-note').textContent", "the reason")
        text = tab.text()
        assert "The right to watch Secrets is missing." in text
        until(lambda: "cannot" in tab.read("document.querySelector('#graph-note').textContent"),
              "why there are no topics", 120)  # fmt: skip
        assert tab.complaints() == []
        tab.close()
