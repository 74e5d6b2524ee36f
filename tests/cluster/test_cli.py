"""Every command against a real release: what it prints, what it does, its exit code."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_lab.images.ros1base import build
from tests.support.recorder import Recorder
from tests.support.until import until

from ..ros1.conftest import unpack_root
from .background import Background
from .conftest import own_namespace

pytestmark = pytest.mark.cluster

TALKER = """
import rospy, std_msgs.msg
rospy.init_node("talker")
rospy.loginfo("talker begins")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=1)
rate = rospy.Rate(5)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rospy.loginfo("said hello")
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

    def write(self, **env: str) -> None:
        """Write the Rigelfile (JSON is YAML); `env` is the talker's."""
        nodes = {
            "talker": {"args": ["python3", "-c", TALKER], "env": env},
            "lab/listener": {"args": ["python3", "-c", LISTENER]},
        }
        options = {"ros_master_image": self.image, "image": self.image, "nodes": nodes}
        self.save({"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}})

    def save(self, jobs: dict[str, Any]) -> None:
        """Write a Rigelfile with these jobs."""
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


@pytest.fixture(scope="module")
def rootfs() -> Path:
    """ROS 1 on a computer beside the cluster."""
    return unpack_root(build(Recorder()))


@pytest.fixture
def start(robot: Robot) -> Iterator[Callable[..., Background]]:
    """Start commands that go on; all are interrupted in the end."""
    started: list[Background] = []

    def call(*words: str) -> Background:
        started.append(Background(robot.command(*words)))
        return started[-1]

    yield call
    for one in started:
        one.interrupt()


def test_render_is_what_apply_sends(robot: Robot, cluster: Any) -> None:
    """The API server takes every rendered document, and finds nothing to change by it."""
    for manifest in yaml.safe_load_all(robot("render").stdout):
        ref = ref_of(manifest)

        def read_both(ref: ObjectRef = ref, manifest: Any = manifest) -> tuple[Any, Any] | None:
            live, after = cluster.get(ref), cluster.apply(manifest, dry_run=True)
            for meta in (live["metadata"], after["metadata"]):
                meta.pop("managedFields")
            versions = {live["metadata"]["resourceVersion"], after["metadata"]["resourceVersion"]}
            return (live, after) if len(versions) == 1 else None  # a controller wrote in between

        live, after = until(read_both, f"moment in which no one writes {ref}")
        assert after == live


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


def test_nodes_have_many_names(robot: Robot) -> None:
    """The key, the ROS name, the Kubernetes name and a pod's name all mean the node."""
    found = json.loads(robot("status", "-o", "json").stdout)
    pod = found["workloads"][0]["pods"][0]["name"]
    for name in ("lab/listener", "/lab/listener", "lab-listener", pod):
        assert "heard hello" in robot("logs", name, "--tail", "1").stdout
    error = robot("logs", "taker", code=2).stderr
    assert 'did you mean "talker"?' in error
    assert "lab-listener, ros-master, talker" in error


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


def test_a_ros1_node_in_development_is_heard_again(
    robot: Robot, start: Callable[..., Background], tmp_path: Path
) -> None:
    """Its restarted program takes its name at once; no hand-over and no gate delays that."""
    (tmp_path / "file").touch()
    running = start("dev", "talker", "--sync", f"{tmp_path}:/tmp/developed")
    until(lambda: running.found("said hello"), "its first message", 240)
    (tmp_path / "file").write_text("changed")
    until(lambda: sum("talker begins" in line for line in running.lines) == 2, "new start", 240)
    begun = len(robot("logs", "lab/listener").stdout.splitlines())
    until(lambda: len(robot("logs", "lab/listener").stdout.splitlines()) > begun, "message", 240)
    assert running.interrupt() == 130
    assert robot("diff").stdout == ""


#: A node on another computer: hears the talker, and is heard.
LAPTOP = """
import rospy, std_msgs.msg
rospy.init_node("laptop")
publisher = rospy.Publisher("/from_laptop", std_msgs.msg.String, queue_size=1, latch=True)
publisher.publish("hi")
rospy.Subscriber("/chatter", std_msgs.msg.String, lambda s: print("heard", s.data, flush=True))
rospy.spin()
"""
HEARS = """
import rospy, std_msgs.msg
rospy.init_node("asks", anonymous=True)
print(rospy.wait_for_message("/from_laptop", std_msgs.msg.String, 60).data)
"""


def test_a_ros1_node_of_another_computer_joins(
    robot: Robot, cluster: Any, start: Callable[..., Background], rootfs: Path
) -> None:
    """It hears and is heard; when its computer is killed, its pod ends, and the next removes it."""
    names = f"mount --bind /etc/resolv.conf {rootfs}/etc/resolv.conf"
    node = (
        f'{names} && exec chroot {rootfs} env ROS_DISTRO=noetic /ros_entrypoint.sh python3 -c "$0"'
    )
    running = start("join", "--", "sh", "-c", node, LAPTOP)
    until(lambda: running.found("heard hello"), "message of the talker", 240)
    assert robot("exec", "talker", "--", "python3", "-c", HEARS).stdout == "hi\n"

    def list_joined() -> dict[str, str]:
        labels = {"app.kubernetes.io/name": "rigel-join"}
        found = cluster.list("v1", "Pod", robot.namespace, labels=labels)
        return {one["metadata"]["name"]: one["status"]["phase"] for one in found}

    (killed,) = list_joined()
    assert killed not in robot("status").stdout + robot("graph").stdout
    assert "/laptop" in robot("graph").stdout
    running.interrupt(signal.SIGKILL)
    until(lambda: list_joined() == {killed: "Succeeded"}, "end of its pod", 60)
    assert robot("join", "--", "sh", "-c", "exit 7", code=7).stdout == ""
    assert list_joined() == {}


def test_logs_follow_through_a_restart_and_a_roll_out(
    robot: Robot, cluster: Any, start: Any
) -> None:
    """A container that starts again, and the pod of the next version, go on in the same output.

    The master ends the talker: a rospy node that gets SIGINT within `publish` waits for itself for
    ever (a signal handler wants the lock that the main thread holds).
    """
    last = ("logs", "--tail", "1", "talker")
    until(lambda: "said hello" in robot(*last).stdout, "a line after the beginning")
    running = start("logs", "-f", "--tail", "1", "talker")
    until(lambda: running.found("said hello"), "hello")
    assert not running.found("talker begins"), "--tail left the beginning out"
    robot("exec", "lab/listener", "--", "rosnode", "kill", "/talker")
    until(lambda: running.found("talker begins"), "beginning", 180)
    before = robot("logs", "--previous", "--tail", "1", "talker").stdout
    assert before in [f"{line}\n" for line in running.lines]
    begun = len([line for line in running.lines if "talker begins" in line])
    robot.write(COLOR="green")
    robot("run", "job", "deploy", "--timeout", "4m")
    until(
        lambda: len([x for x in running.lines if "talker begins" in x]) > begun,
        "new beginning",
        180,
    )
    assert running.interrupt() == 130
    own = "/rigel_k8s/"  # a rospy node that is killed may print a traceback, too
    assert not any(own in line for line in running.lines)


def test_status_tells_orphans_and_the_way_out(robot: Robot, cluster: Any) -> None:
    """When roscore has come back empty, status says so, exits with 1 and names the command."""
    jobs = json.loads(robot.file.read_text())["jobs"]
    jobs["deploy"]["with"]["gate"] = False  # which would give it its registrations back
    robot.save(jobs)
    robot("run", "job", "deploy", "--timeout", "4m")
    master = json.loads(robot("status", "-o", "json").stdout)["workloads"][1]["pods"][0]["name"]
    cluster.delete(ObjectRef("v1", "Pod", robot.namespace, master))

    def told() -> Done | None:
        done = subprocess.run(
            robot.command("status"), capture_output=True, text=True, check=False, timeout=300
        )
        lines = [line for line in done.stdout.splitlines() if "rigel -n" in line]
        both = any("lab-listener talker" in line for line in lines)  # each is probed in its turn
        orphaned = done.returncode == 1 and both
        return done if orphaned and "is an orphan" in done.stdout else None

    done = until(told, "word of it", 300)
    assert "is an orphan" in done.stdout
    way_out = next(line for line in done.stdout.splitlines() if "rigel -n" in line)
    assert way_out.split()[:4] == ["rigel", "-n", robot.namespace, "restart"]
    robot(*way_out.split()[3:])
    assert robot("status").returncode == 0
    robot.write()


def test_doctor_finds_what_a_deploy_needs(robot: Robot) -> None:
    """Each need is a line; without a cluster it says what to do and exits with 1."""
    assert "rights in" in robot("doctor").stdout
    found = json.loads(robot("doctor", "-o", "json").stdout)
    assert {"cluster", "nodes"} <= {need["what"] for need in found}
    assert [need["problem"] for need in found if need["problem"]] == []
    wrong = Robot(robot.file.parent, "no-such-context", robot.namespace, robot.image)
    assert "no-such-context" in wrong("doctor", code=1).stdout
