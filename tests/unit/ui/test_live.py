"""A release that changes, as the feed has it: by one set of watches, and through outages."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import attrs
import pytest

from rigel_graph.commands.graph import LiveGraph
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import locking as lease
from rigel_k8s.release.locking import DURATION, lease_ref
from rigel_k8s.release.types import Desired
from rigel_ui import live as module
from rigel_ui.feed import Feed
from rigel_ui.live import Live
from tests.support.clock import Leap
from tests.support.controllers import crash_status, running
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, ref, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, down
from tests.support.until import until

SECONDS = 60.0


@attrs.define
class Scene:
    """A cluster, a release on it, and who looks at it."""

    fake: FakeCluster
    feed: Feed = attrs.field(factory=Feed)
    told: list[str] = attrs.field(factory=list)
    graph: RosGraph | ClusterError = attrs.field(factory=RosGraph)
    live: Live | None = None

    def start(self) -> None:
        found = Release(self.fake, RELEASE)  # type: ignore[arg-type]
        self.live = Live(found, self.feed, self.told.append, self.read)
        self.live.start()

    def read(self, found: Release) -> LiveGraph:
        if isinstance(self.graph, ClusterError):
            raise self.graph
        return LiveGraph(found.id, self.graph, ())

    def deploy(self, *objects: Any) -> None:
        deploy(Desired(RELEASE, objects), self.fake, report=Recorder())  # type: ignore[arg-type]

    def play(self, kubelet: Callable[[Any], Any]) -> None:
        """Let pods become something else."""
        controllers: Any = self.fake.store.controllers
        controllers.kubelet, controllers.idle_at = kubelet, 0

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        return until(condition, what, SECONDS, every=0.01, last_words=lambda: self.feed.write_all())

    def until_state(self, name: str, state: str) -> dict[str, Any]:
        def look() -> Any:
            node = self.feed.get(f"node/{name}") or {}
            return node if node.get("state") == state else None

        found: dict[str, Any] = self.until(look, f"{name} to be {state}")
        return found


@pytest.fixture
def scene(fake: FakeCluster, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    monkeypatch.setattr("rigel_ui.graphs.CALM", 0.05)
    monkeypatch.setattr("rigel_ui.live.HEARTBEAT", 0.05)
    made = Scene(fake)
    yield made
    if made.live:
        made.live.close()
        for thread in made.live._threads:
            thread.join(SECONDS)


def test_a_release_is_shown(scene: Scene) -> None:
    """Its nodes, its revision, and that nothing is wrong."""
    scene.deploy(workload(), workload("camera"))
    scene.start()
    scene.until_state("talker", "ready")
    whole = scene.until(lambda: scene.feed.get("release"), "the release")
    assert (whole["revision"], whole["status"], whole["ready"]) == (1, "good", 2)
    scene.until(lambda: scene.feed.get("revision/1"), "the revision")
    assert scene.feed.get("revision/1")["status"] == "good"
    assert scene.feed.get("cluster")["message"] == ""


def test_a_crash_is_shown_with_its_cause_and_that_it_is_over(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stays for some seconds although the node is ready again at once."""
    monkeypatch.setattr("rigel_ui.overview.STEADY", 1.0)
    monkeypatch.setattr("rigel_k8s.release.rollout.standing.STEADY", 1.0)
    scene.deploy(workload())
    scene.start()
    scene.until_state("talker", "ready")
    scene.play(crash_status)
    crashed = scene.until_state("talker", "crashed")
    assert "exited with code 1" in crashed["cause"]
    scene.play(running)
    scene.until_state("talker", "ready")


def test_what_crashed_before_is_no_news(scene: Scene) -> None:
    """A node with restarts of yesterday is ready."""

    def restarted(pod: Any) -> Any:
        status = running(pod)
        status["containerStatuses"][0]["restartCount"] = 4
        return status

    scene.deploy(workload())
    scene.play(restarted)
    pods = scene.fake.list("v1", "Pod", "n")
    assert pods[0]["status"]["containerStatuses"][0]["restartCount"] == 4
    scene.start()
    node = scene.until(lambda: scene.feed.get("node/talker"), "the node")
    assert (node["state"], node["restarts"]) == ("ready", 4)


def test_pods_that_are_replaced_have_not_crashed(scene: Scene) -> None:
    """Neither one that ends with the code of its signal, nor one with fewer restarts."""
    states: list[str] = []

    def ended(pod: Any) -> Any:
        status = running(pod)
        status["containerStatuses"][0]["restartCount"] = 1
        if pod["metadata"].get("deletionTimestamp"):
            last = {"terminated": {"exitCode": 143}}
            status["containerStatuses"][0] |= {"state": last, "ready": False}
        return status

    scene.deploy(workload())
    scene.play(ended)
    scene.fake.list("v1", "Pod", "n")
    scene.start()
    scene.until_state("talker", "ready")
    publish = scene.feed.publish

    def note(group: str, entries: Any) -> None:
        states.extend(node["state"] for node in entries.values() if group == "node")
        publish(group, entries)

    scene.feed.publish = note  # type: ignore[method-assign]
    there = {pod["metadata"]["uid"] for pod in scene.fake.list("v1", "Pod", "n")}
    scene.play(lambda pod: ended(pod) if pod["metadata"]["uid"] in there else {"phase": "Pending"})
    thread = threading.Thread(target=scene.deploy, args=(workload(image="app:2"),), daemon=True)
    thread.start()
    scene.until_state("talker", "starting")
    scene.play(running)
    thread.join(SECONDS)
    scene.until_state("talker", "ready")
    assert "crashed" not in states


def test_a_rollout_is_seen_while_it_happens(scene: Scene) -> None:
    """Who makes it, and which node is not ready yet; then that it is over."""
    scene.deploy(workload())
    scene.start()
    scene.until_state("talker", "ready")
    go_on = threading.Event()
    scene.play(lambda pod: running(pod) if go_on.is_set() else {"phase": "Pending"})
    thread = threading.Thread(target=scene.deploy, args=(workload(image="app:2"),), daemon=True)
    thread.start()
    scene.until_state("talker", "starting")
    whole = scene.until(
        lambda: (r := scene.feed.get("release"))["status"] == "pending" and r["changing"] and r,
        "the roll-out, and who makes it",
    )
    assert whole["changing"].endswith(lease.manifest(lease_ref(RELEASE))["spec"]["holderIdentity"])
    go_on.set()
    scene.play(running)
    thread.join(SECONDS)
    scene.until_state("talker", "ready")
    scene.until(lambda: scene.feed.get("release")["status"] == "good", "the end of the roll-out")
    scene.until(lambda: scene.feed.get("release")["changing"] == "", "the end of the Lease")
    assert scene.feed.get("revision/2")["changes"] == ("talker: image app:1 to app:2",)


def test_a_release_that_is_not_there_yet_is_waited_for(scene: Scene) -> None:
    """And one that is deleted is waited for again."""
    scene.start()
    scene.until(lambda: (scene.feed.get("release") or {}).get("absent"), "nothing")
    scene.deploy(workload())
    scene.until_state("talker", "ready")
    down(scene.fake, RELEASE, volumes=False, report=Recorder())  # type: ignore[arg-type]
    scene.until(lambda: scene.feed.get("release").get("absent"), "nothing again")
    for group in ("node", "revision"):
        scene.until(lambda group=group: scene.feed.list_group(group) == {}, f"the end of {group}")


def test_a_node_that_someone_has_deleted_is_named(scene: Scene) -> None:
    scene.deploy(workload(), workload("camera"))
    scene.start()
    scene.until(lambda: (scene.feed.get("release") or {}).get("well"), "a release that is well")
    scene.fake.delete(ref("Deployment", "camera"))
    whole = scene.until(lambda: (r := scene.feed.get("release"))["missing"] and r, "the loss")
    assert whole["missing"][0].startswith("Deployment camera is missing")
    assert not whole["well"]


def test_a_cluster_that_is_away_is_reported_and_comes_back(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the page and in the terminal; what changed meanwhile is shown afterwards."""
    away = threading.Event()

    def ask(self: Any) -> str:
        if away.is_set():
            raise Refusal("cannot ask: the cluster does not answer")
        return "v1"

    monkeypatch.setattr(FakeCluster, "server_version", ask)
    scene.deploy(workload())
    scene.start()
    scene.until_state("talker", "ready")
    away.set()
    scene.until(lambda: "does not answer" in scene.feed.get("cluster")["message"], "the outage")
    assert scene.feed.get("node/talker")["state"] == "ready", "the page keeps what it shows"
    scene.deploy(workload(), workload("camera"))
    away.clear()
    scene.until(lambda: len(scene.told) > 1, "the cluster's return in the terminal")
    scene.until_state("camera", "ready")
    scene.until(lambda: scene.feed.get("cluster")["message"] == "", "the end of the outage")
    assert scene.told == [
        "cannot ask: the cluster does not answer; waiting for it",
        "the cluster answers again",
    ]


def test_a_cluster_that_says_no_to_the_version_is_there(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A user may be allowed to see the release and nothing else."""

    def ask(self: Any) -> str:
        raise Forbidden("no")

    monkeypatch.setattr(FakeCluster, "server_version", ask)
    scene.deploy(workload())
    scene.start()
    scene.until_state("talker", "ready")
    assert scene.told == []


def test_without_the_right_to_see_secrets_the_nodes_are_shown(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Revisions, and who changes the release, are not."""
    real = FakeCluster.watch

    def watch(self: Any, api_version: str, kind: str, *words: Any, **more: Any) -> Any:
        if kind in ("Secret", "Lease", "Event"):
            raise Forbidden(f"cannot watch {kind}s")
        return real(self, api_version, kind, *words, **more)

    monkeypatch.setattr(FakeCluster, "watch", watch)
    scene.deploy(workload())
    scene.start()
    scene.until_state("talker", "ready")
    whole = scene.until(lambda: scene.feed.get("release"), "the release")
    assert (whole["status"], whole["changing"]) == ("unseen", None)


def test_without_the_right_to_see_workloads_the_page_says_so(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And looks again: the right may be granted."""
    denied = threading.Event()
    denied.set()
    real = FakeCluster.watch

    def watch(self: Any, api_version: str, kind: str, *words: Any, **more: Any) -> Any:
        if kind == "Deployment" and denied.is_set():
            raise Forbidden("cannot watch Deployments", hint="ask for the right")
        return real(self, api_version, kind, *words, **more)

    monkeypatch.setattr(module, "PAUSE", 0.05)
    scene.deploy(workload())
    monkeypatch.setattr(FakeCluster, "watch", watch)
    scene.start()
    scene.until(
        lambda: (
            scene.feed.get("cluster")["message"] == "cannot watch Deployments (ask for the right)"
        ),
        "the refusal",
    )
    denied.clear()
    scene.until_state("talker", "ready")
    assert scene.feed.get("cluster")["message"] == ""


def test_a_holder_that_does_not_renew_its_lease_is_gone(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A deploy whose process was killed on another machine does not go on for ever."""
    seen: list[str] = []
    clock = Leap(lambda: "a laptop" in seen, DURATION)
    monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(module, "LATE", 2 * DURATION)  # the cluster answers all the time
    scene.deploy(workload())
    left = lease.manifest(lease_ref(RELEASE))
    left["metadata"]["annotations"] = {}
    left["spec"]["holderIdentity"] = "a laptop"
    scene.fake.create(left)
    publish = scene.feed.publish

    def note(group: str, entries: Any) -> None:
        seen.extend(whole["changing"] for whole in entries.values() if group == "release")
        publish(group, entries)

    scene.feed.publish = note  # type: ignore[method-assign]
    scene.start()
    scene.until(lambda: seen and seen[-1] == "", "the end of the lease")
    assert "a laptop" in seen


def test_a_crashed_node_stays_in_the_graph_with_its_topics(scene: Scene) -> None:
    """The picture does not jump when a node breaks."""
    talker = GraphNode("talker", "node1", "talker-1", "talker")
    other = GraphNode("camera", "node1", "camera-1", "camera")
    scene.graph = RosGraph((talker, other), (GraphTopic("/chatter", "", ("talker",), ("camera",)),))
    scene.deploy(workload(), workload("camera"))
    scene.start()
    topic = scene.until(lambda: scene.feed.get("topic//chatter"), "the topic")
    assert (topic["from"], topic["lost"]) == (["talker"], [])
    scene.graph = RosGraph((other,), (GraphTopic("/chatter", "", (), ("camera",)),))
    scene.play(
        lambda pod: (
            crash_status(pod) if pod["metadata"]["name"].startswith("talker") else running(pod)
        )
    )
    scene.until_state("talker", "crashed")
    scene.until(lambda: scene.feed.get("topic//chatter")["lost"] == ["talker"], "the lost end")
    assert scene.feed.get("topic//chatter")["from"] == ["talker"]
    assert scene.feed.get("box/talker")["machine"] == "node1"


def test_rates_are_kept_for_new_pages(scene: Scene) -> None:
    """Each reading of the graph adds one; a reading that fails is a gap."""
    talker = GraphNode("talker", "node1", "talker-1", "talker")
    scene.graph = RosGraph((talker,), (GraphTopic("/chatter", "", ("talker",), rate=10.0),))
    scene.deploy(workload())
    scene.start()
    first = scene.until(lambda: scene.feed.list_group("rates"), "the rates")
    scene.graph = ClusterError("the graph cannot be read")
    scene.play(crash_status)
    scene.until(lambda: len(scene.feed.list_group("rates")) > len(first), "another reading")
    found = [one["of"] for one in json.loads(scene.feed.write_all())["all"].values() if "of" in one]
    assert found[0] == {"/chatter": 10.0}
    assert found[-1] == {}


def test_a_graph_that_cannot_be_read_is_no_outage(scene: Scene) -> None:
    """The page says why, and shows the nodes."""
    scene.graph = ClusterError("cannot read the ROS graph: roscore does not run")
    scene.deploy(workload())
    scene.start()
    scene.until_state("talker", "ready")
    scene.until(
        lambda: "roscore does not run" in (scene.feed.get("graph") or {}).get("message", ""),
        "the reason",
    )
    assert scene.feed.get("cluster")["message"] == ""
    scene.until(lambda: scene.feed.get("box/talker"), "the box")
    assert scene.feed.get("box/talker")["machine"] == "node1"
    assert scene.fake.objects[ObjectRef("v1", "Namespace", "", "n")]
