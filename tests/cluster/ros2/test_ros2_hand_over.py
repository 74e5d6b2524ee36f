"""Updates of a ROS 2 robot whose nodes hand over: nothing is lost, nothing comes twice.

One deployment has all that a hand-over keeps apart: a worker with a topic, a service, an action, a
subscription and a latched map, a slow talker, a launch file with a lifecycle manager and the nodes
that it manages, and a lifecycle node by itself. A caller, which is not updated, uses all of them.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ObjectRef
from tests.support.ros2_work import PACKAGE
from tests.support.ros2_work.judge import Verdict, is_answered, judge
from tests.support.until import until

from ..background import Background
from ..conftest import first_container, inside, own_namespace
from .conftest import apart

pytestmark = pytest.mark.cluster

#: What the caller hears beside the worker, by the node's name.
TALKERS = ("talker", "left", "right", "front", "arm", "hand", "managed")
#: Seconds until an event is there, on a busy machine.
PATIENCE = 60
#: Seconds of a goal that takes longer than what the tests do meanwhile.
LONG = 90
#: Seconds until DDS has sent a packet again that a busy machine has lost: after its next heartbeat,
#: which comes every 3 s. So an old node's last messages may come after the new one's first.
RESENT = 5
START = {"start": ["configure", "activate"]}
NO_LAYER = "plain"
#: No ROS node; it ends on SIGINT.
IDLE = ["python3", "-c", "import time; time.sleep(10_000)"]


def requests(cpu: str) -> dict[str, Any]:
    """Return a share of the processors: without one, a pod that is behind stays behind.

    On a busy machine, what it reads overflows, which looks as if a hand-over had lost it.
    """
    return {"resources": {"requests": {"cpu": cpu}}}


@attrs.frozen
class Robot:
    """The deployment, and what its nodes have printed since it began."""

    directory: Path
    namespace: str
    image: str
    network: Any
    context: str
    cluster: Any

    @property
    def file(self) -> Path:
        """Its Rigelfile."""
        return self.directory / "Rigelfile"

    def command(self, *words: str) -> list[str]:
        """Return a command line of rigel on it."""
        place = ["-f", str(self.file), "--context", self.context, "-n", self.namespace]
        return [sys.executable, "-m", "rigel_k8s", *place, *words]

    def rigel(self, *words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run rigel on it."""
        done = subprocess.run(
            self.command(*words), capture_output=True, text=True, timeout=900, check=False
        )
        assert not check or done.returncode == 0, done.stdout + done.stderr
        return done

    def update(
        self, version: str, *, timeout: str = "8m", check: bool = True, **worker: Any
    ) -> subprocess.CompletedProcess[str]:
        """Deploy a version of all nodes but the caller; `worker` has more of that one's options."""
        self.write(version, worker)
        return self.rigel("run", "job", "deploy", "--timeout", timeout, check=check)

    def write(self, version: str, worker: Mapping[str, Any]) -> None:
        """Write the Rigelfile."""
        env = {"VERSION": version}

        def program(name: str, rate: int = 20, cpu: str = "100m") -> dict[str, Any]:
            new = {**env, "RATE": str(rate)}
            package = {"package": PACKAGE, "executable": f"{name}.py"}
            return {**package, "env": new, **requests(cpu)}

        # When others end, Fast DDS may block for good (docs/nodes.md).
        alive = {"liveness": {"stuck": "30s"}}
        launch = {"launch": {"package": PACKAGE, "file": "robot.launch.xml"}, "env": env}
        away = {"placement": {"apart_from": ["caller"]}}
        nodes: dict[str, Any] = {
            "worker": {**program("worker", 100, "300m"), **alive, **away, **worker},
            "talker": {**program("talker"), **alive},
            "robot": {**launch, **alive, **requests("300m")},
            "managed": {**program("managed"), **alive, "lifecycle": START},
            NO_LAYER: {**program("talker"), "rmw_layer": False},
            "caller": {**program("caller", cpu="500m"), "env": {"HEAR": ",".join(TALKERS)}},
        }
        options = {"image": self.image, "network": self.network, "nodes": nodes}
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
        self.file.write_text(json.dumps(whole))

    def pods(self, workload: str) -> list[dict[str, Any]]:
        """Return a workload's pods that have not ended, the oldest first."""
        labels = {"app.kubernetes.io/name": workload}
        found = self.cluster.list("v1", "Pod", self.namespace, labels=labels)
        return sorted(found, key=lambda pod: str(pod["metadata"]["creationTimestamp"]))

    def wait_for_one(self, workload: str) -> dict[str, Any]:
        """Return a workload's pod, once there is one only."""
        until(lambda: len(self.pods(workload)) == 1, f"single pod of {workload}", PATIENCE)
        return self.pods(workload)[0]

    def progress(self, pod: Mapping[str, Any]) -> str:
        """Return what a pod's keeper says."""
        return self.run(pod, "python3", "/rigel-k8s/keeper.py", "state")

    def run(self, pod: Mapping[str, Any], *words: str) -> str:
        """Return what a command prints in a pod's first container; "" if it does not run."""
        name, line = pod["metadata"]["name"], ["/bin/sh", "/rigel-k8s/exec.sh", *words]
        container = first_container(pod)
        with suppress(ClusterError):  # it has not started yet
            done = self.cluster.run(self.namespace, name, line, container=container, timeout=30)
            return str(done.stdout.decode()).strip()
        return ""


@attrs.frozen
class Record:
    """What nodes print while they are updated."""

    follower: Background

    def lines(self, *names: str) -> str:
        """Return the lines of some nodes."""
        found = []
        for line in list(self.follower.lines):
            name, _, rest = line.partition(" ")
            if name.strip("[]") in names:
                found.append(rest)
        return "\n".join(found)

    def verdict(self, chat: str = "chat") -> Verdict:
        """Judge what the caller has heard."""
        return judge(self.lines("caller"), self.lines("worker"), chat)

    def chat(self) -> list[tuple[float, str]]:
        """Return when the worker was heard, and its version."""
        split = (line.split() for line in self.lines("caller").splitlines())
        return [(float(words[0]), words[2]) for words in split if words[1:2] == ["chat"]]

    def until_heard_at(self, when: float) -> None:
        """Wait until the caller hears the worker after a time."""
        until(lambda: any(one > when for one, _ in self.chat()[-20:]), "message", PATIENCE)

    def until_answered(self) -> None:
        """Wait until a call is answered, so that none is open that may be lost."""
        begun = time.time()
        until(lambda: is_answered(self.lines("caller"), begun), "answer to a call", PATIENCE)

    def until_heard(self, version: str, *chats: str) -> None:
        """Wait until the caller hears a version of all of these."""
        for chat in chats:
            line = f" {chat} {version} "
            until(
                lambda line=line: line in self.lines("caller"),
                line,
                PATIENCE,
                every=0.5,
                last_words=lambda: [one for one in self.follower.lines if "caller" not in one],
            )


@pytest.fixture(
    scope="module",
    params=[
        "macvlan",
        pytest.param("peers", marks=pytest.mark.slow),
        pytest.param("discovery-server", marks=pytest.mark.slow),
        pytest.param("host", marks=pytest.mark.slow),
    ],
)
def robot(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    work_image: str,
    context: str,
    admin: Any,
) -> Iterator[Robot]:
    """All nodes in version v1, heard by the caller."""
    network = {"mode": request.param, "domain_id": apart(ros1=False)["domain_id"]}
    if request.param == "macvlan":
        request.getfixturevalue("multus")
        network = {"mode": "macvlan", "interface": "eth0", **apart(ros1=False)}
    directory = tmp_path_factory.mktemp("robot")
    with own_namespace(admin, "t-hand-over") as namespace:
        made = Robot(directory, namespace, work_image, network, context, admin)
        made.update("v1")
        yield made


@pytest.fixture(scope="module")
def record(robot: Robot) -> Iterator[Record]:
    """What all nodes print from now on."""
    with Background(robot.command("logs", "--follow", "--tail", "0")) as follower:
        made = Record(follower)
        made.until_heard("v1", "chat", *(f"chat/{name}" for name in TALKERS))
        yield made


def test_nothing_is_lost_and_nothing_comes_twice(robot: Robot, record: Record) -> None:
    """Topics, calls, goals, the map and numbers: two updates of all nodes, by hand-over.

    Nodes of a launch file with their manager, and one with `lifecycle`, come up beside the old
    ones, whose services have the same names. The caller stays.
    """
    for version in ("v2", "v3"):
        robot.update(version)
        assert "took over" in until(lambda: robot.progress(robot.pods("worker")[-1]), "progress")
        record.until_heard(version, "chat", *(f"chat/{name}" for name in TALKERS))
    record.until_answered()
    found = record.verdict()
    said = [line for line in record.lines("worker").splitlines() if "rigel-k8s" in line]
    assert not found.faults.keys() - {"late"}, (found, said)
    assert found.late < RESENT * 100
    assert found.versions == ("v1", "v2", "v3")
    assert found.maps[-1:] == ("v3",)
    assert min(found.calls, found.counted) > 500
    assert found.goals >= 5
    for name in TALKERS:
        heard = record.verdict(f"chat/{name}")
        assert (heard.versions, heard.doubled, heard.missing) == (found.versions, 0, 0), name
        assert heard.late < RESENT * 20, name


def test_a_node_without_the_layer_is_stopped_first(robot: Robot) -> None:
    """`rmw_layer: false`: no library, no keeper, and an update as before."""
    ref = ObjectRef("apps/v1", "Deployment", robot.namespace, NO_LAYER)
    assert robot.cluster.get(ref)["spec"]["strategy"]["type"] == "Recreate"
    seen = inside(
        robot.cluster, robot.namespace, NO_LAYER, "cat", "/proc/1/environ", "/proc/1/maps"
    )
    assert "RIGEL_RMW" not in seen
    assert "LD_PRELOAD" not in seen
    assert "rmw-" not in seen
    assert "LD_PRELOAD" in inside(
        robot.cluster, robot.namespace, "talker", "cat", "/proc/1/environ"
    )


@pytest.mark.parametrize(
    ("options", "cause"),
    [
        ({"env": {"RATE": "100"}}, "KeyError: 'VERSION'"),
        ({"command": IDLE, "package": None, "executable": None}, "DDS domain"),
    ],
    ids=["crashes", "is no node"],
)
def test_a_new_version_that_fails_changes_nothing(
    robot: Robot, record: Record, options: dict[str, Any], cause: str
) -> None:
    """The old one works all the time, whether the new one crashes or never becomes ready."""
    robot.update("v3")
    old = robot.wait_for_one("worker")
    begun = time.time()
    done = robot.update("v3", timeout="30s", check=False, **options)
    assert done.returncode == 1
    assert cause in done.stdout + done.stderr
    robot.update("v3")
    record.until_heard_at(time.time())
    times = [when for when, _ in record.chat() if when > begun]
    assert max(b - a for a, b in itertools.pairwise(times)) < 20  # the machine is busy
    assert {version for when, version in record.chat() if when > begun} == {"v3"}
    there = robot.wait_for_one("worker")
    assert there["metadata"]["uid"] == old["metadata"]["uid"]


def test_if_the_old_one_ends_the_new_one_works(robot: Robot, record: Record) -> None:
    """It waited for a goal of the old one, whose program ends now; it works before that goal ends.

    The old one's container starts again, finds that the new one works, and waits.
    """
    robot.update("v3")
    old = robot.wait_for_one("worker")
    send = ("exec", "caller", "--", "ros2", "run", PACKAGE, "goal.py", str(LONG))
    with Background(robot.command(*send)) as goal:
        until(lambda: goal.found("accepted"), "accepted goal", PATIENCE)
        robot.write("v3", {"env": {"VERSION": "v4", "RATE": "100"}})
        with Background(robot.command("run", "job", "deploy", "--timeout", "3m")) as deploy:
            new = until(lambda: robot.pods("worker")[1:], "new pod", PATIENCE)[0]
            line = f"waits to take over: {old['metadata']['name']} has"
            until(lambda: robot.progress(new).startswith(line), line, PATIENCE, every=0.5)
            until(lambda: deploy.found(line), f"line of the deploy: {line}", PATIENCE)
            robot.run(old, "kill", "-INT", "1")
            record.until_heard("v4", "chat")
            assert record.verdict().gaps[-1] < LONG / 3
            assert robot.progress(new).startswith("works, ")
            until(
                lambda: deploy.found("done"),
                "end of the deploy",
                PATIENCE,
                last_words=lambda: deploy.lines,
            )
