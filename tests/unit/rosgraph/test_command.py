"""`rigel graph`: from a release's pods to what is printed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_graph import reading
from rigel_graph.commands import expect
from rigel_graph.commands import graph as actions
from rigel_graph.types import GraphTopic, RosGraph
from rigel_k8s.cli import main
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import UserError
from rigel_k8s.observability.reading.prometheus import Sample
from rigel_k8s.observability.reading.stack import NoStack
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from tests.support.rosgraph import ros_graph

from .graphs import ODD, ROBOT, live
from .local import LocalCluster

RELEASE = ReleaseId("robots", "explorer")


def pod(workload: str, ip: str, ros_name: str = "") -> dict[str, Any]:
    return {
        "metadata": {
            "name": f"{workload}-1",
            "namespace": "robots",
            "labels": {"app.kubernetes.io/name": workload},
            "annotations": {"rigel-k8s/ros-name": ros_name} if ros_name else {},
        },
        "spec": {"nodeName": "node1", "containers": [{"name": "c"}]},
        "status": {
            "podIP": ip,
            "conditions": [{"type": "Ready", "status": "True"}],
            "containerStatuses": [{"name": "c", "state": {"running": {}}}],
        },
    }


class ReleaseCluster(LocalCluster):
    """A release's pods and Deployments; their network is this machine's loopback."""

    def __init__(self, *pods: dict[str, Any], **variables: str) -> None:
        super().__init__(**variables)
        self.items = {"Pod": list(pods), "Deployment": [self.deployment("talker", "/talker")]}

    def deployment(self, name: str, ros_name: str) -> dict[str, Any]:
        notes = {"rigel-k8s/ros-name": ros_name}
        return {"metadata": {"name": name, "annotations": notes}, "spec": {"replicas": 1}}

    def list(self, api_version: str, kind: str, namespace: str, **_: Any) -> list[dict[str, Any]]:
        assert namespace == "robots"
        return self.items[kind]

    def __enter__(self) -> ReleaseCluster:
        return self

    def __exit__(self, *_: object) -> None:
        pass


@pytest.mark.programs
def test_a_releases_graph_is_read_in_its_masters_pod() -> None:
    """Nodes are placed, one of the release that is not there is named."""
    with ros_graph() as graph:
        graph.node("/amcl", ["/pose"])
        pods = pod("ros-master", "10.0.0.1"), pod("nav", "127.0.0.1")
        cluster: Any = ReleaseCluster(*pods, ROS_MASTER_URI=graph.master.uri)
        found = reading.read_graph(cluster, RELEASE)
    assert cluster.pods == ["ros-master-1"]
    assert [(node.name, node.pod, node.machine, node.registered) for node in found.nodes] == [
        ("/amcl", "nav-1", "node1", True),
        ("/talker", "", "", False),
    ]


def test_a_release_without_pods_is_named() -> None:
    cluster: Any = ReleaseCluster()
    with pytest.raises(UserError, match="no pod of explorer is in the namespace robots"):
        reading.read_graph(cluster, RELEASE)


def test_rates_come_from_prometheus_where_it_knows_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is heard counts before what nodes count; what the graph itself knows stays."""
    samples = {"counted": [Sample({"topic": "/odom"}, 40.0)]}
    samples["heard"] = [Sample({"topic": "/odom"}, 50.0)]
    cluster: Any = None
    monkeypatch.setattr(actions, "ask_prometheus", lambda found, queries: samples)
    rates = actions.measure_rates(Release(cluster, RELEASE))
    assert rates == {"/odom": 50.0}
    known = {topic.name: topic.rate for topic in ROBOT.with_rates(rates).topics}
    assert (known["/odom"], known["/cmd_vel"], known["/goal"]) == (50.0, 20.0, None)


def test_without_a_stack_there_are_no_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(found: Release, queries: object) -> None:
        raise NoStack("there is none")

    cluster: Any = None
    monkeypatch.setattr(actions, "ask_prometheus", fail)
    assert actions.measure_rates(Release(cluster, RELEASE)) == {}


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What the command gets, one for each look; the last for all that follow."""
    looks: list[Any] = [live(ROBOT)]

    def look(settings: Settings, job: str | None) -> Any:
        answer = looks.pop(0) if len(looks) > 1 else looks[0]
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(actions, "graph", look)
    return looks


def test_exit_code_1_where_something_is_wrong(
    found: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run(["graph"], "rigel") == 1
    assert "/planner does not answer" in capsys.readouterr().out
    found[:] = [live(RosGraph())]
    assert main.run(["graph", "-o", "json"], "rigel") == 0
    assert json.loads(capsys.readouterr().out)["ok"] is True


def test_a_topic_without_publisher_alone_is_no_error(found: list[Any]) -> None:
    """It may be meant so: a joystick that nobody has plugged in."""
    goal = [topic for topic in ROBOT.topics if topic.name == "/goal"]
    found[:] = [live(attrs.evolve(ROBOT, nodes=(), topics=tuple(goal)))]
    assert found[0].problems
    assert main.run(["graph"], "rigel") == 0


def test_text_has_no_colour_in_a_pipe(found: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    main.run(["graph"], "rigel")
    assert "\x1b" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "begin"),
    [
        ("a.dot", "digraph"),
        ("a.json", "{"),
        ("a", "rel"),
    ],
)
def test_a_files_name_says_its_form(
    name: str, begin: str, found: list[Any], tmp_path: Path
) -> None:
    main.run(["graph", "--to", str(tmp_path / name)], "rigel")
    assert (tmp_path / name).read_text().startswith(begin)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_layout_prefers_the_expected_topics(
    found: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file's suffix does not show that it is one; other forms do not read what is expected."""
    cameras = (GraphTopic(f"/c{n}", "sensor_msgs/msg/Image", ("/a",)) for n in range(5))
    found[:] = [live(RosGraph(topics=tuple(cameras)))]
    file, read = tmp_path / "layout.json", []
    monkeypatch.setattr(expect, "name_expected", lambda *_: read.append(1) or ("/c4",))
    assert main.run(["graph", "-o", "foxglove", "--to", str(file)], "rigel") == 0
    panels = json.loads(file.read_text())["configById"]
    assert panels["Image!1"] == {"imageMode": {"imageTopic": "/c4"}}
    assert main.run(["graph", "--to", str(file)], "rigel") == 0
    assert json.loads(file.read_text())["ok"] is True
    assert read == [1]


@pytest.mark.programs
@pytest.mark.skipif(shutil.which("dot") is None, reason="Graphviz is not installed")
@pytest.mark.parametrize(
    ("name", "begin"), [("a.svg", b"<?xml"), ("a.png", b"\x89PNG"), ("a.pdf", b"%PDF")]
)
@pytest.mark.parametrize("graph", [ROBOT, ODD, RosGraph()])
def test_graphviz_draws_pictures(
    name: str, begin: bytes, graph: RosGraph, found: list[Any], tmp_path: Path
) -> None:
    found[:] = [live(graph)]
    assert main.run(["graph", "--to", str(tmp_path / name)], "rigel") == int(not found[0].ok)
    assert (tmp_path / name).read_bytes().startswith(begin)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_without_graphviz_one_error_says_how_to_get_it(
    found: list[Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Exit code 1, and the old picture stays."""
    file = tmp_path / "a.svg"
    file.write_text("old")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main.run(["graph", "--to", str(file)], "rigel") == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("error:") == 1
    assert "dot is not installed" in told.err
    assert "hint: install graphviz" in told.err
    assert file.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.svg"]


def test_a_file_that_cannot_be_written_is_the_users_error(
    found: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run(["graph", "--to", str(tmp_path / "no" / "a.svg")], "rigel") == 2
    assert "cannot write" in capsys.readouterr().err
