"""A deploy that watches the ROS graph: what an update did to it is reported, or undone."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_graph import idle, reading, watching
from rigel_graph.discovery import check as discovery
from rigel_graph.reading import Listed
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_graph.watching import GraphWorse
from rigel_k8s import kube
from rigel_k8s.errors import ClusterError, Interrupted, RigelK8sError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.types.orchestration import OrchestrationJob
from rigel_k8s.release import revisions
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Application, Settings
from tests.support.clock import Clock, Waits
from tests.support.fake_cluster import FakeCluster
from tests.support.options import options
from tests.support.recorder import Recorder
from tests.support.rosgraph import until

RELEASE = ReleaseId("n", "rigel-k8s-application")
IMAGE = "lab/app@sha256:" + "ab" * 32
LIDAR = {"args": ["lidar"], "env": {"PUBLISHES": "/scan"}}
DUMB = {"args": ["lidar"], "env": {"PUBLISHES": ""}}
PLANNER = {"args": ["planner"], "env": {"SUBSCRIBES": "/scan"}}
LOST = "/scan had 1 publisher, now 0"


@attrs.define
class World:
    """A robot on the fake cluster, whose nodes have the topics that their environment names.

    Attributes:
        nodes: of the Rigelfile.
        failures: what the next readings of the graph fail with, None for one that does not.
        readings: how often the graph was read.
        stop_after: the reading at which Ctrl-C is pressed.
        at_first: what is called when the graph is read before an update.
    """

    fake: FakeCluster
    report: Recorder
    nodes: dict[str, Any]
    failures: list[RigelK8sError | None] = attrs.field(factory=list)
    cancel: Waits = attrs.field(factory=lambda: Waits(Clock()))
    readings: int = 0
    stop_after: int = 0
    at_first: Callable[[], None] = lambda: None

    def read_graph(
        self, cluster: Any, release: ReleaseId, *, span: float, listed: Listed | None = None
    ) -> RosGraph:
        """Return the graph that the release's Deployments make, listed before or now."""
        assert (cluster, release) == (self.fake, RELEASE)
        self.readings += 1
        if self.readings == 1:
            self.at_first()
        if self.readings == self.stop_after:
            self.cancel.set()
        if self.failures and (failure := self.failures.pop(0)):
            raise failure
        nodes, ends = [], {"PUBLISHES": {}, "SUBSCRIBES": {}}  # type: ignore[var-annotated]
        for name, env, ros_name in self.list_nodes(listed):
            nodes.append(GraphNode(ros_name, "n1", f"{name}-1", name))
            for word, found in ends.items():
                for topic in env.get(word, "").split():
                    found.setdefault(topic, []).append(ros_name)
        topics = sorted({*ends["PUBLISHES"], *ends["SUBSCRIBES"]})
        return RosGraph(
            tuple(nodes),
            tuple(
                GraphTopic(name, "T", *(tuple(found.get(name, ())) for found in ends.values()))
                for name in topics
            ),
        )

    def list_nodes(self, listed: Listed | None = None) -> Iterator[tuple[str, dict[str, str], str]]:
        for item in (listed or reading.list_objects(self.fake, RELEASE)).deployments:  # type: ignore[arg-type]
            notes = item["metadata"].get("annotations") or {}
            (container,) = item["spec"]["template"]["spec"]["containers"]
            env = {one["name"]: one.get("value", "") for one in container.get("env", [])}
            if "rigel-k8s/ros-name" in notes and item["spec"]["replicas"]:
                yield item["metadata"]["name"], env, notes["rigel-k8s/ros-name"]

    def is_updated(self) -> bool:
        """Whether a node of the second version is on the cluster."""
        items = self.fake.list("apps/v1", "Deployment", "n")
        pods = (item["spec"]["template"]["spec"]["containers"][0] for item in items)
        return any("v2" in pod["args"] for pod in pods)

    def deploy(self, *, distro: str = "noetic", now: bool = False, **more: Any) -> None:
        """Run the job, and forget what the report had before."""
        self.report.entries.clear()
        self.readings = 0
        raw = {"image": IMAGE, "nodes": self.nodes, **more}
        if distro == "noetic":
            raw["deploy_ros_master"] = False
        where = Settings(namespace="n", now=now)
        job = JobContext(
            "deploy", Application(distro), self.report, where, raw=raw, cancel=self.cancel
        )
        OrchestrationJob().run(options(raw), job)

    def statuses(self) -> list[str]:
        return [one.status for one in revisions.history(self.fake, RELEASE)]  # type: ignore[arg-type]


@pytest.fixture
def bare(fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch) -> World:
    """A lidar and a planner that hears it, to be deployed."""
    made = World(fake, report, {"lidar": LIDAR, "planner": PLANNER})
    monkeypatch.setattr(kube, "connect", lambda settings: fake)
    monkeypatch.setattr("rigel_graph.reading.read_graph", made.read_graph)
    for module in (watching, idle):
        monkeypatch.setattr(module, "time", made.cancel.clock)
    monkeypatch.setattr(discovery, "check", lambda *_: None)
    return made


@pytest.fixture
def world(bare: World) -> World:
    """Both, deployed."""
    bare.deploy()
    assert bare.readings == 1, "there is nothing to compare a first deploy with"
    assert bare.report.warnings == []
    return bare


def test_a_first_deploy_names_topics_that_do_not_fit(bare: World) -> None:
    """The most common mistake in ROS; the deploy is good."""
    bare.nodes["planner"] = {**PLANNER, "env": {"SUBSCRIBES": "/scann"}}
    bare.deploy()
    line = "/scann has no publisher; subscribed by /planner; is /scan meant, which is published?"
    assert bare.report.warnings == [f"{line} [no-publisher]"]
    assert bare.readings > 1, "nodes may need a moment"
    assert bare.statuses() == ["good"]


def test_notes_from_before_a_look_that_failed_are_not_used_again(
    bare: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They may be a minute old: the check of discovery reads its own."""
    nodes = (GraphNode("/lidar", "n1", "lidar-1", "lidar"),)
    looks = [RosGraph(nodes, notes={"lidar-1/node": {}})]

    def read(*_: Any, **__: Any) -> RosGraph:
        if not looks:
            raise ClusterError("no answer")
        return looks.pop()

    monkeypatch.setattr("rigel_graph.reading.read_graph", read)
    watch = watching.GraphWatch(bare.fake, RELEASE, bare.report, bare.cancel)  # type: ignore[arg-type]
    watch._before = RosGraph(nodes, (GraphTopic("/scan", "T", ("/lidar",)),))
    assert watch.find_differences() is None
    assert watch.notes == {}


def test_a_revision_has_the_whole_path_of_its_folder(bare: World) -> None:
    """The Rigelfile's own folder is "." where most commands are typed: that names no robot."""
    bare.deploy()
    (revision,) = revisions.history(bare.fake, RELEASE)  # type: ignore[arg-type]
    assert revision.source == str(Path.cwd())


def test_a_first_graph_that_cannot_be_read_is_no_warning(bare: World) -> None:
    """`rigel graph` reports why."""
    bare.nodes["planner"] = {**PLANNER, "env": {"SUBSCRIBES": "/scann"}}
    bare.failures = [ClusterError("no answer")]
    bare.deploy()
    assert bare.report.warnings == []


def test_an_update_waits_until_the_robot_is_idle(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`update: {when: idle}`: without that nothing is changed, unless it is to be now."""
    asked: list[tuple[ReleaseId, dict[str, float]]] = []

    def list_busy(_: Any, release: ReleaseId, silent: dict[str, float]) -> list[str]:
        asked.append((release, silent))
        return ["/navigate has a goal"]

    monkeypatch.setattr(idle, "list_busy", list_busy)
    when = {"when": "idle", "within": "1s", "silent": {"cmd_vel": "3s"}}
    world.deploy(update=when)
    assert asked == [], "no pod is replaced"
    before = world.statuses()
    world.nodes["planner"] = {**PLANNER, "args": "faster"}
    with pytest.raises(ClusterError, match="not idle within 1 s: /navigate has a goal"):
        world.deploy(update=when)
    assert asked[0] == (RELEASE, {"/cmd_vel": 3.0})
    assert (world.readings, world.statuses()) == (0, before)
    asked.clear()
    world.deploy(update=when, now=True)
    assert asked == []
    assert world.statuses() == ["superseded", *before]


def test_an_unchanged_deploy_reads_nothing(world: World) -> None:
    world.deploy()
    assert world.readings == 0
    assert "ROS graph" not in " ".join(world.report.texts)


def test_an_update_that_replaces_no_pod_reads_nothing(world: World) -> None:
    labels = {"metadata": {"labels": {"team": "blue"}}}
    world.nodes = {"lidar": {**LIDAR, "patch": labels}, "planner": PLANNER}
    world.deploy()
    assert world.statuses() == ["superseded", "good"]
    assert world.readings == 0


def test_a_harmless_update_is_read_twice(world: World) -> None:
    """Once before, once after."""
    world.nodes = {"lidar": {**LIDAR, "args": ["lidar", "v2"]}, "planner": PLANNER}
    world.deploy()
    assert world.readings == 2
    assert world.report.warnings == []
    assert ("ROS graph", "2 nodes and 1 topic before the update", True) in world.report.states
    assert world.report.states[-1] == ("ROS graph", "as before the update", True)


def test_it_is_read_before_the_first_write(world: World) -> None:
    """What is written ends nodes; so the same thread reads first, and writes then."""
    seen: list[tuple[bool, bool]] = []
    writer = threading.current_thread()
    world.at_first = lambda: seen.append((world.is_updated(), threading.current_thread() is writer))
    world.nodes = {"lidar": {**LIDAR, "args": ["lidar", "v2"]}, "planner": PLANNER}
    world.deploy()
    assert seen == [(False, True)]


def test_nodes_that_hand_over_are_read_while_new_ones_start(bare: World) -> None:
    """The old ones work for longer than that takes; what an update lacks is missed all the same."""
    jazzy: Any = {"distro": "jazzy", "network": "peers"}
    bare.deploy(**jazzy)
    bare.at_first = lambda: until(bare.is_updated, "update")
    bare.nodes = {"lidar": DUMB, "planner": {**PLANNER, "args": ["planner", "v2"]}}
    bare.deploy(**jazzy)
    assert bare.report.warnings == [LOST]


@pytest.mark.parametrize("where", [None, {"graph_worse": False}])
def test_a_lost_publisher_is_a_warning(world: World, where: Any) -> None:
    """And the job is good: nothing asks for more."""
    world.nodes = {"lidar": DUMB, "planner": PLANNER}
    world.deploy(rollback_on=where)
    assert world.report.warnings == [LOST]
    assert world.readings > 2
    assert world.statuses() == ["superseded", "good"]


def test_a_node_that_comes_back_late_is_no_warning(
    world: World,
) -> None:
    """Nodes take a moment to be in the graph again; a reading may fail meanwhile."""
    world.nodes = {"lidar": {**LIDAR, "args": ["lidar", "v2"]}, "planner": PLANNER}
    world.failures = [None, ClusterError("the pod is starting"), None]
    world.deploy()
    assert world.readings == 3
    assert world.report.warnings == []


def test_what_changed_on_purpose_is_reported(world: World) -> None:
    """A node that the Rigelfile no longer has is not missing, nor is a renamed one."""
    world.nodes = {"planner": {**PLANNER, "name": "router"}, "imu": {"args": ["imu"]}}
    world.deploy()
    assert world.report.warnings == []
    assert world.report.lines[-5:] == [
        "  /lidar is removed",
        "  /planner is removed",
        "  /imu is new",
        "  /router is new",
        "  /scan has no publisher; subscribed by /router",
    ]


def test_a_node_that_moves_to_another_workload_is_still_expected(world: World) -> None:
    world.nodes = {"front": {**DUMB, "name": "lidar"}, "planner": PLANNER}
    world.deploy()
    assert world.report.warnings == [LOST]


def test_fewer_pods_are_meant(world: World) -> None:
    world.nodes = {"lidar": {**LIDAR, "patch": {"spec": {"replicas": 0}}}, "planner": PLANNER}
    world.deploy()
    assert world.report.warnings == []
    assert "  /scan has no publisher; subscribed by /planner" in world.report.lines


@pytest.mark.parametrize("where", [None, {"graph_worse": True}])
def test_a_graph_that_cannot_be_read_fails_no_deploy(world: World, where: Any) -> None:
    """One line says why, and it is not read again."""
    world.nodes = {"lidar": DUMB, "planner": PLANNER}
    world.failures = [ClusterError("you may not create pods/exec", details=["ask for it"])]
    world.deploy(rollback_on=where)
    assert world.report.warnings == [
        "the ROS graph is not compared: you may not create pods/exec\n  ask for it"
    ]
    assert world.readings == 1


def test_a_graph_that_cannot_be_read_afterwards_is_a_warning(world: World) -> None:
    """No one knows that it is worse."""
    world.nodes = {"lidar": DUMB, "planner": PLANNER}
    world.failures = [None, *(ClusterError("roscore does not run") for _ in range(999))]
    world.deploy(rollback_on={"graph_worse": True, "within": "0.1s"})
    assert world.report.warnings == ["the ROS graph cannot be compared: roscore does not run"]
    assert world.statuses() == ["superseded", "good"]


def test_zenoh_without_the_layer_is_not_read(world: World) -> None:
    """Its graph cannot be, so that a warning at each update would say nothing new."""
    release: Any = {"distro": "jazzy", "middleware": "zenoh", "deployment_name": "zenoh"}
    release["rmw_layer"] = False
    for node in (LIDAR, DUMB):
        world.nodes = {"camera": node}
        world.deploy(**release)
        assert world.readings == 0


def test_programs_without_ros_are_not_read(bare: World) -> None:
    """They have no graph; it is read once a node of ROS was there before the update."""
    release: Any = {"distro": "jazzy", "network": {"mode": "peers"}, "rmw_layer": False}
    none = {"ros": "none", "args": ["serve"]}
    for nodes, is_read in (
        ({"web": none}, False),
        ({"web": {**none, "args": ["v2"]}}, False),
        ({"web": none, "lidar": LIDAR}, False),
        ({"web": none, "lidar": DUMB}, True),
    ):
        bare.nodes = nodes
        bare.deploy(**release)
        assert bool(bare.readings) is is_read


# Rolling back


def test_a_worse_graph_is_rolled_back(world: World) -> None:
    """The job fails, and says what was worse and what was done."""
    world.nodes = {"lidar": DUMB, "planner": PLANNER}
    with pytest.raises(GraphWorse) as caught:
        world.deploy(rollback_on={"graph_worse": True, "within": "0.2s"})
    assert caught.value.exit_code == 1
    assert caught.value.message == (
        "the ROS graph of rigel-k8s-application in n is worse than before the update:"
        " rolled back to revision 1, as revision 3"
    )
    assert caught.value.details == (LOST,)
    assert caught.value.hint is not None
    assert [env["PUBLISHES"] for name, env, _ in world.list_nodes() if name == "lidar"] == ["/scan"]
    assert world.statuses() == ["superseded", "failed", "good"]
    assert revisions.history(world.fake, RELEASE)[-1].description == "rollback to revision 1"  # type: ignore[arg-type]


def test_a_harmless_update_is_not_rolled_back(world: World) -> None:
    """What has changed is reported."""
    world.nodes = {"lidar": LIDAR, "planner": PLANNER, "imu": {"args": ["imu"]}}
    world.deploy(rollback_on={"graph_worse": True, "within": "0.2s"})
    assert world.readings == 2
    assert "  /imu is new" in world.report.lines
    assert world.statuses() == ["superseded", "good"]


@pytest.mark.parametrize(
    ("where", "status"), [(None, "good"), ({"graph_worse": True}, "interrupted")]
)
def test_ctrl_c_ends_the_watch(world: World, where: Any, status: str) -> None:
    """What was applied stays; an update that was to be verified is not good yet."""
    world.nodes = {"lidar": DUMB, "planner": PLANNER}
    world.stop_after = 2
    with pytest.raises(Interrupted, match="what was applied stays"):
        world.deploy(rollback_on=where)
    assert world.statuses()[-1] == status
