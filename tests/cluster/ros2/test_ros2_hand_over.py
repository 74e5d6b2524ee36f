"""Updates of a ROS 2 robot whose nodes hand over: nothing is lost, nothing comes twice.

One deployment has all that a hand-over keeps apart: a worker with a topic, a service, an action, a
subscription and a latched map, a slow talker, a launch file with a lifecycle manager and the nodes
that it manages, and a lifecycle node by itself. A caller, which is not updated, uses all of them.
"""

from __future__ import annotations

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
from tests.support.ros2_work import PACKAGE
from tests.support.ros2_work.judge import Verdict, is_answered, judge
from tests.support.until import until

from ..background import Background
from ..conftest import first_container, own_namespace
from .conftest import apart

pytestmark = pytest.mark.cluster

#: What the caller hears beside the worker, by the node's name.
TALKERS = ("talker", "left", "right", "front", "arm", "hand", "managed")
#: Seconds until an event is there, on a busy machine.
PATIENCE = 60
#: Seconds until DDS has sent a packet again that a busy machine has lost: after its next heartbeat,
#: which comes every 3 s. So an old node's last messages may come after the new one's first.
RESENT = 5
START = {"start": ["configure", "activate"]}


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

    def update(self, version: str) -> None:
        """Deploy a version of all nodes but the caller."""
        self.write(version)
        deploy = self.command("run", "job", "deploy", "--timeout", "8m")
        done = subprocess.run(deploy, capture_output=True, text=True, timeout=900, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

    def write(self, version: str) -> None:
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
            "worker": {**program("worker", 100, "300m"), **alive, **away},
            "talker": {**program("talker"), **alive},
            "robot": {**launch, **alive, **requests("300m")},
            "managed": {**program("managed"), **alive, "lifecycle": START},
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
