"""Commands against a real release: what they print, and what they leave behind."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from tests.support.until import until

from .conftest import own_namespace

pytestmark = pytest.mark.cluster

TALKER = """
import rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=1)
rate = rospy.Rate(5)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rate.sleep()
"""
LISTENER = """
import rospy, std_msgs.msg
rospy.init_node("listener")
rospy.Subscriber("/chatter", std_msgs.msg.String, lambda s: rospy.loginfo("heard " + s.data))
rospy.spin()
"""

Done = subprocess.CompletedProcess[str]


class Robot:
    """A Rigelfile in a directory of its own, and the command line beside it."""

    def __init__(self, directory: Path, context: str, namespace: str, image: str) -> None:
        self.file = directory / "Rigelfile"
        self.context = context
        self.namespace = namespace
        self.image = image
        self.write()

    def write(self) -> None:
        """Write the Rigelfile (JSON is YAML)."""
        nodes = {
            "talker": {"args": ["python3", "-c", TALKER]},
            "lab/listener": {"args": ["python3", "-c", LISTENER]},
        }
        options = {"ros_master_image": self.image, "image": self.image, "nodes": nodes}
        jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}}

        self.file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))

    def command(self, *words: str) -> list[str]:
        """Return the command line's words, cluster and namespace before the command."""
        place = ["-f", str(self.file), "--context", self.context, "-n", self.namespace]
        return [sys.executable, "-m", "rigel_k8s", *place, *words]

    def __call__(self, *words: str, code: int = 0, **options: Any) -> Done:
        """Run a command that ends with this exit code."""
        done = subprocess.run(
            self.command(*words),
            capture_output=True,
            text=True,
            check=False,
            timeout=600,
            **options,
        )
        assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done


@pytest.fixture(scope="module")
def robot(
    context: str, cluster: Any, base_image: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Robot]:
    """A talker and a listener, deployed once for all tests of this file."""
    with own_namespace(cluster, "t-cli") as name:
        made = Robot(tmp_path_factory.mktemp("robot"), context, name, base_image)
        made("run", "job", "deploy", "--timeout", "4m")
        yield made


def test_kubectl_reads_the_render(robot: Robot, context: str) -> None:
    """`rigel render | kubectl apply` works: kubectl's reader sees the same text."""
    status = subprocess.run(
        [sys.executable, "-m", "rigel_k8s", "cluster", "status", "-o", "json"]
        + ["--name", context.removeprefix("rigel-")],
        capture_output=True,
        text=True,
        check=False,
    )
    if status.returncode:
        pytest.skip("no local cluster, which would bring kubectl along")
    kubectl = json.loads(status.stdout)["kubectl"]
    assert kubectl, "the cluster was started without --with kubectl"
    done = subprocess.run(
        [*kubectl.split(), "--context", context, "apply", "--server-side", "--dry-run=server"]
        + ["--field-manager=rigel", "-f", "-"],
        input=robot("render").stdout,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "deployment.apps/talker serverside-applied (server dry run)" in done.stdout


def test_graph_shows_nodes_topics_and_rates(robot: Robot, tmp_path: Path) -> None:
    """As the master and the nodes tell it, and no node hears of a new subscriber."""

    def read_graph() -> Any:
        found = json.loads(robot("graph", "-o", "json").stdout)
        rates = [topic["rate"] or 0 for topic in found["topics"] if topic["name"] == "/chatter"]
        return found if rates and 3 < rates[0] < 7 else None

    found = until(read_graph, "a graph of a moment in which the talker keeps to its 5 Hz")
    nodes = {node["name"]: node for node in found["nodes"]}
    assert {"/talker", "/lab/listener"} <= set(nodes)
    assert (nodes["/talker"]["workload"], nodes["/talker"]["up"]) == ("talker", True)
    assert nodes["/lab/listener"]["pod"].startswith("lab-listener-")
    (chatter,) = (topic for topic in found["topics"] if topic["name"] == "/chatter")
    assert (chatter["type"], chatter["publishers"], chatter["subscribers"]) == (
        "std_msgs/String",
        ["/talker"],
        ["/lab/listener"],
    )
    assert 3 < chatter["rate"] < 7
    assert "/talker" in robot("graph").stdout
    robot("graph", "--to", str(tmp_path / "graph.svg"))
    picture = ElementTree.parse(tmp_path / "graph.svg").getroot()
    assert picture.tag == "{http://www.w3.org/2000/svg}svg"
    assert "/chatter" in "".join(picture.itertext())


def test_a_command_ends_with_its_caller(robot: Robot) -> None:
    """Kubernetes leaves it alone, and one that listens to a silent topic would stay there."""
    words = robot.command("exec", "talker", "--", "sleep", "77777")

    def is_there() -> bool:
        looked = robot(
            "exec", "talker", "--", "sh", "-c", "cat /proc/[0-9]*/cmdline | tr '\\0' ' '"
        )
        return "sleep 77777" in looked.stdout

    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as caller:
        until(is_there, "the command")
        caller.send_signal(signal.SIGINT)
        assert caller.communicate(timeout=60)[1].strip() == "interrupted"
    assert caller.returncode == 130
    until(lambda: not is_there(), "its end")


def test_topics_and_parameters_need_no_ros_here(robot: Robot) -> None:
    """Messages, rates and parameters; a killed command leaves no process and no node behind."""
    assert robot("topic", "echo", "chatter", "--once").stdout == "data: hello\n---\n"
    (line,) = robot("topic", "list").stdout.splitlines()[1:]
    assert line.split()[:2] == ["/chatter", "std_msgs/String"]
    robot("param", "set", "talker", "speed", "2.5")
    assert robot("param", "get", "/talker", "speed").stdout == "2.5\n"
    assert "did you mean" in robot("param", "get", "talker", "sped", code=2).stderr
    command = robot.command("topic", "echo", "/chatter")
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"data: hello\n"
        assert "_rigel" in robot("exec", "talker", "--", "rosnode", "list").stdout
        assert "_rigel" not in robot("graph", "-o", "json").stdout
        process.kill()
    until(
        lambda: "_rigel" not in robot("exec", "talker", "--", "rosnode", "list").stdout,
        "end of the subscriber",
    )
