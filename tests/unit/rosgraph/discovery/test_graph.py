"""What is told about a release's DDS graph, from what was seen in its pods."""

from __future__ import annotations

import json
import threading
from typing import Any

import attrs
import pytest

from rigel_graph.discovery import check as graphs
from rigel_graph.discovery.findings import DiscoveryGraph, graph
from rigel_graph.discovery.looks import Observation, look, of_notes
from rigel_graph.discovery.losses import Flow
from rigel_graph.discovery.members import Member, members
from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.kube.execution import ExecResult
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.text import join_words
from rigel_k8s.problems import Problem
from rigel_k8s.release.types import ReleaseId
from tests.support.members import NOTE, PROBE, member, pod
from tests.support.notes import answer, process
from tests.support.recorder import Recorder


def test_member():
    """A pod's annotations, its machine and its environment make a member."""
    servers = [{"name": "ROS_DISCOVERY_SERVER", "value": "a:11811;;b:11811"}]
    (found,) = members([pod(env=servers)])
    assert found == Member(
        namespace="robots",
        pod="talker-1",
        workload="talker",
        machine="node1",
        container="ros-node",
        mode="macvlan",
        domain=3,
        middleware="fastdds",
        interface="net1",
        address="10.1.0.7",
        ip="10.244.1.2",
        servers=("a:11811", "b:11811"),
        own_ways=(),
        running=True,
    )


def test_promised_address():
    """A static address that the Rigelfile gives counts more than what Multus says."""
    (found,) = members([pod(note={**NOTE, "address": "10.1.0.9/24"})])
    assert found.address == "10.1.0.9"


@pytest.mark.parametrize(
    "without",
    [
        pod(note=None),
        pod(note={**NOTE, "ros": "1"}),
        pod(note="no object"),
        pod(deletionTimestamp="2026-01-01T00:00:00Z"),
        {**pod(), "status": {**pod()["status"], "phase": "Succeeded"}},
    ],
    ids=["no annotation", "ROS 1", "no object", "ending", "ran once"],
)
def test_no_member(without: dict[str, Any]):
    """Pods that take no part in DDS, are ending, or have ended, are left out."""
    assert members([without]) == []


def test_own_ways():
    """A pod without `network` that brings its own discovery is not blamed for its multicast."""
    env = [{"name": "ROS_STATIC_PEERS", "value": "robot"}]
    (found,) = members([pod(note={"mode": "none", "ros": "2"}, env=env)])
    assert found.own_ways == ("ROS_STATIC_PEERS",)


def noted(name: str, *discovered: str, **fields: Any) -> Observation:
    """What a pod with notes shows: its node, and which nodes it has discovered."""
    nodes = {f"/{name}": 0.0}
    seen = frozenset(f"/{other}" for other in (name, *discovered))
    return Observation(**{"nodes": nodes, "discovered": seen, **fields})


def layered(name: str, machine: str = "node1", **more: Any) -> Member:
    """A pod whose processes have the layer."""
    return member(name, machine, has_layer=True, **more)


def every(*names: str) -> dict[str, Observation]:
    """Pods that have all discovered each other."""
    return {name: noted(name, *names) for name in names}


def without(looks: dict[str, Observation], one: str, other: str) -> dict[str, Observation]:
    """The same, but that one pod has not discovered another one."""
    seen = (looks[one].discovered or frozenset()) - {f"/{other}"}
    return {**looks, one: attrs.evolve(looks[one], discovered=seen)}


def messages(found: DiscoveryGraph) -> list[str]:
    return [problem.message for problem in found.problems]


def test_in_order():
    """Nodes that have discovered each other are in order, whatever their middleware is."""
    pods = [layered("a", "node1", middleware="zenoh"), layered("b", "node2", mode="zenoh")]
    found = graph(pods, every("a", "b"))
    assert found.problems == found.deaf == ()
    assert [(pod.discovered_by, pod.out_of) for pod in found.pods] == [(("b",), 1), (("a",), 1)]


def test_every_node_of_a_pod_counts():
    """And each of its processes must have discovered the others."""
    several = noted("a", "b", nodes={"/a": 0.0, "/a2": 0.0})
    found = graph([layered("a"), layered("b")], {"a": several, "b": noted("b", "a")})
    assert messages(found) == ["a is not discovered by any other pod"]
    parts = [process("/a", seen=["/a", "/b"]), process("/a2", pid=8, seen=["/a", "/a2"])]
    assert of_notes(answer(*parts)) == Observation(
        nodes={"/a": 0.0, "/a2": 0.0}, discovered=frozenset({"/a"})
    )


def test_nodes_of_one_name_discover_each_other_if_each_has_seen_both():
    """As two `ros2 topic`, each process 1 of its pod: what has their name may be its own node."""
    pods = [layered("a", "node1"), layered("b", "node2")]
    alone, both = noted("same"), noted("same", twice=frozenset({"/same"}))
    assert graph(pods, {"a": alone, "b": alone}).deaf == (("node1", "node2"),)
    found = graph(pods, {"a": both, "b": both})
    assert found.deaf == ()
    assert [pod.discovered_by for pod in found.pods] == [("b",), ("a",)]
    seen = of_notes(answer(process("/same", seen=["/same", "/same", "/other"])))
    assert (seen.discovered, seen.twice) == ({"/same", "/other"}, {"/same"})


def flow(topic: str, partners: int, *, sent: bool) -> Flow:
    """What one end of a topic shows."""
    return Flow("/n", topic, "std_msgs/msg/String", sent, 10, 1.0, partners, steady=True, idle=True)


@pytest.mark.parametrize(
    ("sender", "taker", "known"), [(2, 1, True), (1, 1, False), (2, 0, False), (3, 1, True)]
)
def test_partners_of_a_topic_are_discovered(sender: int, taker: int, known: bool) -> None:  # noqa: FBT001
    """Names of nodes may be missing for ever after a cut; c is the topic's other subscriber."""
    looks = every("a", "b", "c")
    looks = without(without(looks, "a", "b"), "b", "a")
    ends = {
        "a": flow("/t", sender, sent=True),
        "b": flow("/t", taker, sent=False),
        "c": flow("/t", 1, sent=False),
    }
    looks = {pod: attrs.evolve(looks[pod], flows=(end,)) for pod, end in ends.items()}
    found = graph([layered(pod) for pod in ends], looks)
    assert ("b" in (found.pods[0].discovered_by or ())) is known


def test_who_has_forgotten_names_is_not_asked_for_others() -> None:
    """Two talkers have no topic in common, and after a cut no name; their listener hears both."""
    looks = every("a", "b", "ears")
    for one, other in (("a", "b"), ("b", "a"), ("a", "ears"), ("b", "ears")):
        looks = without(looks, one, other)
    ends = {
        "a": (flow("/a", 1, sent=True),),
        "b": (flow("/b", 1, sent=True),),
        "ears": (flow("/a", 1, sent=False), flow("/b", 1, sent=False)),
    }
    heard = {pod: attrs.evolve(looks[pod], flows=flows) for pod, flows in ends.items()}
    found = graph([layered(pod) for pod in ends], heard)
    assert found.problems == ()
    assert [(pod.discovered_by, pod.out_of) for pod in found.pods][:2] == [(("ears",), 1)] * 2
    assert graph([layered(pod) for pod in ends], looks).problems != ()


def test_a_pod_that_waits_to_take_over_discovers_as_others_do():
    """Its nodes exist; so an update is not a problem of discovery."""
    waits = of_notes(answer(process("/a", mode=1, seen=["/a", "/b"])))
    found = graph([layered("a"), layered("b")], {"a": waits, "b": noted("b", "a")})
    assert found.problems == ()


@pytest.mark.parametrize(
    ("mode", "ready", "fine"),
    [("peers", False, True), ("peers", True, False), ("macvlan", False, False)],
)
def test_one_that_has_no_name_yet_is_not_missed(mode: str, ready: bool, fine: bool):  # noqa: FBT001
    """With peers, two new pods of an update discover each other when one of them is ready."""
    looks = without(without(every("a", "b", "c"), "b", "a"), "a", "b")
    found = [layered("a", mode=mode, ready=ready), layered("b", mode=mode), layered("c", mode=mode)]
    assert (graph(found, looks).problems == ()) is fine


def test_one_pod_is_named_once():
    """The one that most others miss; not each of those that miss it."""
    looks = without(without(every("a", "b", "c"), "b", "a"), "c", "a")
    found = graph([layered(name) for name in "abc"], looks)
    assert [(p.message, p.kind, p.is_error) for p in found.problems] == [
        ("a is not discovered by any other pod", "undiscovered", True)
    ]
    assert "ROS_DOMAIN_ID" in found.problems[0].remedy
    assert [pod.discovered_by for pod in found.pods] == [(), ("c",), ("b",)]


def test_machines_are_named_where_no_pods_of_them_discover_each_other():
    """One finding, with the network as its cause, in place of one for each pair of pods."""
    names = {"a": "node1", "b": "node1", "c": "node2"}
    looks = {"a": noted("a", "b"), "b": noted("b", "a"), "c": noted("c")}
    found = graph([layered(name, machine) for name, machine in names.items()], looks)
    assert found.deaf == (("node1", "node2"),)
    assert messages(found) == ["the pods on node1 and node2 do not discover each other"]
    assert "IGMP snooping" in found.problems[0].remedy
    assert found.problems[0].remedy.endswith("; or does the image of c set ROS_DOMAIN_ID?")
    assert found.problems[0].is_error


def test_machines_of_which_some_pods_discover_each_other_are_not_blamed():
    """The packets of one pod pass, so the other one is the cause."""
    names = {"a": "node1", "b": "node2", "c": "node2"}
    looks = without(every("a", "b", "c"), "a", "b")
    found = graph([layered(name, machine) for name, machine in names.items()], looks)
    assert found.deaf == ()
    assert messages(found) == ["a is not discovered by b"]


def test_a_machine_that_is_cut_off_is_one_finding():
    names = {"a": "node1", "b": "node2", "c": "node3"}
    looks = {"a": noted("a"), "b": noted("b", "c"), "c": noted("c", "b")}
    found = graph([layered(name, machine) for name, machine in names.items()], looks)
    assert messages(found) == ["the pods on node1 and on other machines do not discover each other"]
    looks["b"], looks["c"] = noted("b"), noted("c")
    found = graph([layered(name, machine) for name, machine in names.items()], looks)
    assert messages(found) == ["the pods on different machines do not discover each other"]
    assert "ROS_DOMAIN_ID" not in found.problems[0].remedy


@pytest.mark.parametrize(
    ("mode", "remedy", "error"),
    [
        ("none", "set `network`", False),
        ("peers", "Service", True),
        ("discovery-server", "server's pod", True),
        ("zenoh", "router's pod", True),
    ],
)
def test_the_remedy_is_that_of_the_network(mode: str, remedy: str, error: bool):  # noqa: FBT001
    """Without `network` nothing promises that nodes discover each other: a warning."""
    pods = [layered("a", "node1", mode=mode), layered("b", "node2", mode=mode)]
    (problem,) = graph(pods, {"a": noted("a"), "b": noted("b")}).problems
    assert remedy in problem.remedy
    assert problem.is_error is error


def test_an_executor_that_stands_still_is_named():
    """Its node is discovered and ready, and does nothing."""
    looks = every("a", "b")
    looks["a"] = attrs.evolve(looks["a"], nodes={"/a": 41.2})
    (problem,) = graph([layered("a"), layered("b")], looks).problems
    assert problem.message == "/a: no turn of its executor for 41 s"
    assert not problem.is_error


def test_a_process_with_more_topics_than_it_has_room_for_is_named():
    """What it publishes beyond that is not counted, and seems to be missing."""
    found = [member("a")]
    processes = [process("/a"), process("/b", full=3)]
    looks = {found[0].pod: noted("/a", "/a", notes={"second": {"processes": processes}})}
    [problem] = graph(found, looks).problems
    assert (problem.kind, problem.severity) == ("not-noted", "warning")
    assert problem.message == f"{found[0].pod}: the graph lacks 3 of its topics and services"


def test_what_one_that_stands_still_has_discovered_is_unknown():
    """It notes that with its turns: nodes that came later are no fault of the network."""
    found = [layered("planner"), layered("lidar", "node2"), layered("arm", "node3")]
    looks = without(without(every("planner", "lidar", "arm"), "planner", "lidar"), "planner", "arm")
    assert {problem.kind for problem in graph(found, looks).problems} == {"deaf"}
    looks["planner"] = attrs.evolve(looks["planner"], nodes={"/planner": 20.0})
    assert [problem.kind for problem in graph(found, looks).problems] == ["stuck"]


@pytest.mark.parametrize(("probe", "error"), [(PROBE, True), (["/healthy"], False)])
def test_a_program_without_nodes(probe: list[str], error: bool):  # noqa: FBT001
    """Who gives a node another readiness may mean one without ROS: reported, and no error."""
    (found,) = members([pod(probe=probe)])
    found = attrs.evolve(found, has_layer=True)
    (problem,) = graph([found], {found.pod: of_notes(answer())}).problems
    assert (problem.kind, problem.is_error) == ("no-participant", error)
    assert problem.message == "talker-1 has no ROS 2 node"


def heard(*addresses: str) -> Observation:
    """What a participant in a pod without notes has heard."""
    return Observation(heard=frozenset(addresses))


def bare(name: str, address: str) -> Member:
    """A pod without the layer."""
    return attrs.evolve(member(name), address=address)


def test_pods_without_notes_are_told_apart_by_their_addresses():
    """DDS without ROS, and `rmw_layer: false`; only a participant shows who is there."""
    pods = [bare("a", "10.1.0.1"), bare("b", "10.1.0.2"), bare("c", "10.1.0.3")]
    both = ("10.1.0.1", "10.1.0.2")
    found = graph(pods, {"a": heard(*both), "b": heard(*both), "c": heard()})
    assert messages(found) == ["c has no DDS participant"]
    assert [pod.discovered_by for pod in found.pods] == [("b",), ("a",), None]


def test_beside_pods_with_notes_those_without_are_seen_in_one_direction():
    """What their nodes are called is unknown, so nothing is said of who has discovered them."""
    pods = [layered("a"), bare("b", "10.1.0.2")]
    found = graph(pods, {"a": noted("a"), "b": heard("10.1.0.2")})
    assert found.problems == ()


def test_forbidden():
    """Where exec is forbidden that is reported once, and is no error: nothing is known."""
    problem = Observation(
        "commands in pods are not allowed (the right `create pods/exec` is missing)"
    )
    found = graph([member("a"), member("b")], {"a": problem, "b": problem})
    assert [str(f) for f in found.problems] == [
        "a and b could not be checked: commands in pods are not allowed (the right `create"
        " pods/exec` is missing) [not-looked]"
    ]
    assert found.errors == ()
    assert [pod.discovered_by for pod in found.pods] == [None, None]


class Cluster:
    """A cluster whose pods print an answer, or refuse."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer
        self.asked: list[str] = []

    def parallel(self, function: Any, items: Any) -> Any:
        return [function(item) for item in items]

    def run(self, namespace: str, pod: str, *_: Any, **__: Any) -> ExecResult:
        self.asked.append(pod)
        if isinstance(self.answer, Exception):
            raise self.answer
        return ExecResult(0, json.dumps(self.answer).encode(), b"")


def test_notes_are_read_where_they_are():
    notes = answer(process("/a", seen=["/a", "/b"]))
    cluster: Any = Cluster({"first": notes, "second": notes})
    assert look(cluster, [layered("a")]) == {"a": noted("a", "b")}
    assert cluster.asked == ["a"]
    read = {"a/ros-node": {"first": notes, "second": notes}}
    assert look(cluster, [layered("a")], read) == {"a": noted("a", "b")}
    assert cluster.asked == ["a"], "what was read a moment ago is not read again"
    cluster = Cluster({"addresses": ["10.1.0.1"]})
    assert look(cluster, [member("a")]) == {"a": heard("10.1.0.1")}


def test_a_program_on_dds_alone_is_heard_although_its_pod_has_the_layer():
    """It loads no middleware of ROS, so it notes nothing; on zenoh alone it cannot be seen."""
    nothing = answer()
    found = {"first": nothing, "second": nothing, "addresses": ["10.1.0.1"]}
    cluster: Any = Cluster(found)
    assert look(cluster, [layered("a")]) == {"a": heard("10.1.0.1")}
    silent = attrs.evolve(layered("a"), middleware="zenoh")
    assert graph([silent], look(cluster, [silent])).problems == ()
    bare = answer(process(""))
    bare["processes"][0]["entities"] = []
    cluster = Cluster({"first": bare, "second": bare})
    (problem,) = graph([silent], look(cluster, [silent])).problems
    assert problem.message == "a has no ROS 2 node"


@pytest.mark.parametrize(
    "unknown",
    [{"middleware": "zenoh"}, {"domain": None}, {"own_ways": ("CYCLONEDDS_URI",)}],
    ids=["zenoh", "domain of the image", "own way"],
)
def test_what_cannot_be_joined_is_unknown(unknown: dict[str, Any]):
    """It is not a problem, and nothing is run."""
    cluster: Any = Cluster({})
    pods = [attrs.evolve(member(name), **unknown) for name in "ab"]
    found = graph(pods, look(cluster, pods))
    assert (found.problems, cluster.asked) == ((), [])
    assert [pod.discovered_by for pod in found.pods] == [None, None]


@pytest.mark.parametrize(
    ("failure", "reason"),
    [
        (Forbidden("pods is forbidden"), "commands in pods are not allowed"),
        (
            ClusterError(
                'Internal error: Post "https://10.0.0.1:10250/exec/robots/a": dial tcp'
                " 10.0.0.1:10250: connect: no route"
            ),
            "the API server cannot reach its machine (no route)",
        ),
    ],
    ids=["forbidden", "no route"],
)
def test_a_refusal_becomes_a_reason_in_words(failure: Exception, reason: str):
    cluster: Any = Cluster(failure)
    assert look(cluster, [member("a")])["a"].problem.startswith(reason)


def test_what_does_not_run_or_is_out_of_reach_is_not_asked():
    """Nothing is sent to it, so that nothing waits for its answer."""
    cluster: Any = Cluster({})
    pods = [member("a", running=False), attrs.evolve(member("b"), reachable=False)]
    found = look(cluster, pods)
    assert found["a"].problem == "its container does not run"
    assert found["b"].problem == "Kubernetes cannot reach the machine node1"
    assert cluster.asked == []


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[DiscoveryGraph | None]:
    """What successive looks find; the last one for ever."""
    found: list[DiscoveryGraph | None] = []

    def glance(*_: Any) -> DiscoveryGraph | None:
        return found.pop(0) if len(found) > 1 else found[0]

    monkeypatch.setattr(graphs, "look_briefly", glance)
    monkeypatch.setattr(graphs, "AGAIN", 0.0)
    monkeypatch.setattr(graphs, "LATER", 0.0)
    monkeypatch.setattr(graphs, "list_pods", lambda *_: [])
    return found


RELEASE = ReleaseId("robots", "app")
WRONG = DiscoveryGraph((), (), (Problem((), "node2 is deaf", "deaf", remedy="look"),))
GOOD = DiscoveryGraph((), (), ())
DOUBT = DiscoveryGraph(
    (), (), (Problem((), "no multicast", "deaf", "warning", remedy="set network"),)
)


def run_check(report: Recorder, cancel: threading.Event | None = None) -> None:
    graphs.check(RELEASE, None, report, cancel or threading.Event())  # type: ignore[arg-type]


def test_check_has_patience(looks: list[DiscoveryGraph | None]):
    """Discovery takes a moment: what a later look does not find any more is no error."""
    looks += [WRONG, WRONG, GOOD]
    run_check(Recorder())
    assert len(looks) == 1


def test_check_ends_in_an_error(
    looks: list[DiscoveryGraph | None], monkeypatch: pytest.MonkeyPatch
):
    """What stays wrong is an error that says that the release is deployed anyway."""
    monkeypatch.setattr(graphs, "PATIENCE", 0.05)
    looks.append(WRONG)
    with pytest.raises(graphs.DiscoveryError) as caught:
        run_check(Recorder())
    assert caught.value.exit_code == 1
    assert caught.value.message.startswith("app in robots is deployed, but")
    assert caught.value.details == ("node2 is deaf; look [deaf]",)


def test_on_a_busy_machine_looks_count_instead_of_seconds(
    looks: list[DiscoveryGraph | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A look takes long there, and so does discovery; what no load explains is an error at once."""
    monkeypatch.setattr(graphs, "PATIENCE", 0.0)
    looks += [WRONG] * (graphs.LOOKS - 1) + [GOOD]
    run_check(Recorder())
    looks[:] = [WRONG] * graphs.LOOKS + [GOOD]
    with pytest.raises(graphs.DiscoveryError):
        run_check(Recorder())
    monkeypatch.setattr(graphs, "LONGEST", 0.0)
    looks[:] = [WRONG, GOOD]
    with pytest.raises(graphs.DiscoveryError):
        run_check(Recorder())


def test_what_a_busy_machine_may_explain_is_looked_at_again(looks: list[DiscoveryGraph | None]):
    """A second look decides; what no time explains is told at once."""
    looks += [WRONG, GOOD]
    assert graphs.survey(None, RELEASE) is GOOD  # type: ignore[arg-type]
    lacking = Problem((), "one could not be checked", "not-looked")
    wrong = DiscoveryGraph((), (), (lacking,))
    looks[:] = [wrong, GOOD]
    assert graphs.survey(None, RELEASE) is wrong  # type: ignore[arg-type]
    looks[:] = [DOUBT, GOOD]
    assert graphs.survey(None, RELEASE) is DOUBT  # type: ignore[arg-type]


def test_check_without_network(looks: list[DiscoveryGraph | None]):
    """What the Rigelfile did not promise is a warning, at once."""
    looks.append(DOUBT)
    report = Recorder()
    run_check(report)
    assert report.warnings == ["no multicast; set network [deaf]"]


def test_check_of_ros_1(looks: list[DiscoveryGraph | None]):
    """A release without DDS is left alone."""
    looks.append(None)
    run_check(Recorder())


def crashed(times: int) -> dict[str, Any]:
    """Return a pod whose container has ended so often, and runs again."""
    ended = {"exitCode": 1, "reason": "Error", "message": "no device"}
    state = {"running": {}} if not times else {"terminated": ended}
    one = {
        "name": "ros-node",
        "image": "a",
        "restartCount": times,
        "state": state,
        "ready": not times,
    }
    spec = {"containers": [{"name": "ros-node"}]}
    meta = {"name": "a-1", "uid": "u"}
    return {"metadata": meta, "spec": spec, "status": {"containerStatuses": [one]}}


UNSEEN = DiscoveryGraph((), (), (Problem((), "a-1: exit code 137", "not-looked", "warning"),))


@pytest.mark.parametrize("found", [GOOD, UNSEEN])
def test_a_node_that_crashes_after_it_was_ready_is_an_error(
    looks: list[DiscoveryGraph | None], monkeypatch: pytest.MonkeyPatch, found: DiscoveryGraph
) -> None:
    """Kubernetes may report it a moment later, if the pod could not be looked at."""
    looks.append(found)
    pods = [[crashed(2)], *([[crashed(2)]] if found is UNSEEN else []), [crashed(3)]]
    monkeypatch.setattr(graphs, "list_pods", lambda *_: pods.pop(0))
    with pytest.raises(graphs.DiscoveryError, match="1 pod crashed after being ready") as caught:
        run_check(Recorder())
    assert "no device" in caught.value.details[0]
    assert pods == []


def test_a_node_that_crashed_before_is_none_of_this_deploy(
    looks: list[DiscoveryGraph | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And one that cannot be looked at is only a warning."""
    monkeypatch.setattr(graphs, "CRASH", 0.05)
    monkeypatch.setattr(graphs, "list_pods", lambda *_: [crashed(2)])
    looks.append(UNSEEN)
    report = Recorder()
    run_check(report)
    assert report.warnings == ["a-1: exit code 137 [not-looked]"]


def test_check_can_be_stopped(looks: list[DiscoveryGraph | None]):
    """Ctrl-C ends the looks."""
    looks.append(WRONG)
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(Interrupted):
        run_check(Recorder(), cancel)


def test_listed():
    """Names in words, a long list cut."""
    assert [join_words("a"), join_words("ab"), join_words("abc")] == ["a", "a and b", "a, b and c"]
    assert join_words("abcdefgh") == "a, b, c, d, e, f and 2 more"
