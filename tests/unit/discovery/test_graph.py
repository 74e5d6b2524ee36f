"""What is told about a release's DDS graph, from what was seen in its pods."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from typing import Any

import attrs
import pytest

from rigel_k8s.discovery import check as graphs
from rigel_k8s.discovery import looks as graph_looks
from rigel_k8s.discovery.findings import DiscoveryGraph, graph
from rigel_k8s.discovery.looks import ANNOUNCERS, Observation, commands, look
from rigel_k8s.discovery.members import Member, members
from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.text import join_words
from rigel_k8s.problems import Problem
from rigel_k8s.release.types import ReleaseId
from tests.support.members import NOTE, PROBE, member, pod
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


@pytest.mark.parametrize(("probe", "error"), [(PROBE, True), (["/healthy"], False)])
def test_a_program_without_dds(probe: list[str], error: bool):  # noqa: FBT001
    """Who gives a node another readiness may mean one without DDS: told, and no error."""
    (found,) = members([pod(probe=probe)])
    found = attrs.evolve(found, address=None)
    (finding,) = graph([found], {found.pod: seen("x", own=[], heard=[])}).problems
    assert (finding.kind, finding.is_error) == ("no-participant", error)


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
    ],
    ids=["no annotation", "ROS 1", "no object", "ending"],
)
def test_no_member(without: dict[str, Any]):
    """Pods that take no part in DDS, or are ending, are left out."""
    assert members([without]) == []


def test_own_ways():
    """A pod without `network` that brings its own discovery is not blamed for its multicast."""
    env = [{"name": "ROS_STATIC_PEERS", "value": "robot"}]
    (found,) = members([pod(note={"mode": "none", "ros": "2"}, env=env)])
    assert found.own_ways == ("ROS_STATIC_PEERS",)
    assert not found.by_multicast


def participant(name: str, *, own: bool) -> dict[str, Any]:
    return {"prefix": name, "own": own}


def seen(name: str, *others: str, **more: Any) -> Observation:
    """What a pod tells that hears others, and is in order itself."""
    heard = [participant(name, own=True), *(participant(other, own=False) for other in others)]
    process = {"pid": 1, "command": "node", "domain": 3, "stopped": False, "ports": []}
    told = {
        "interfaces": {"net1": "10.1.0.7"},
        "own": [process],
        "heard": heard,
        "beacons": frozenset(others),
        "announced": True,
        "sends": True,
    }
    return Observation(**{**told, **more})


def test_a_machine_sends_once():
    """One pod of each machine sends beacons, however many it has."""
    found = [member(f"pod-{i}", f"node{i % 3}") for i in range(9)]
    senders = [name for name, words in commands(found).items() if "--beacon" in words]
    assert senders == ["pod-0", "pod-1", "pod-2"]


def test_the_number_of_announcements_is_bounded():
    """In a large release some pods announce themselves, among them one of each machine."""
    found = [member(f"pod-{i:03}", f"node{i // 10}") for i in range(100)]
    words = commands(found)
    announcing = {name for name in words if "--announce" in words[name]}
    assert len(announcing) == ANNOUNCERS
    assert {name for name in words if "--beacon" in words[name]} <= announcing


def test_in_order():
    """Nodes that hear each other are in order, and each is discovered by all others."""
    found = graph(
        [member("a", "node1"), member("b", "node2")], {"a": seen("a", "b"), "b": seen("b", "a")}
    )
    assert found.problems == ()
    assert [pod.discovered_by for pod in found.pods] == [("b",), ("a",)]


def test_every_participant_of_a_pod_counts():
    """A pod with several participants is discovered where all of them are."""
    several = [participant(name, own=True) for name in ("a", "a2")]
    looks = {"a": seen("a", "b", heard=[*several, participant("b", own=False)])}
    looks["b"] = seen("b", "a")
    found = graph([member("a", "node1"), member("b", "node2")], looks)
    assert [f.message for f in found.problems] == ["a is not discovered by any other pod"]


def test_one_way():
    """A direction in which no beacon arrives is deaf, the other one is not."""
    looks = {"a": seen("a", "b", beacons=frozenset()), "b": seen("b", "a")}
    found = graph([member("a", "node1"), member("b", "node2")], looks)
    assert found.deaf == (("node2", "node1"),)
    assert [f.message for f in found.problems] == [
        "multicast at net1 from node2 does not reach node1"
    ]


@pytest.mark.parametrize(
    ("machines", "message"),
    [
        (
            ("node1", "node2"),
            "the pods on node1 and node2 do not discover each other: the pod network carries no"
            " multicast from machine to machine",
        ),
        (
            ("node1", "node1"),
            "the pods on node1 do not discover each other: the pod network carries no multicast",
        ),
    ],
    ids=["two machines", "one machine"],
)
def test_pod_network(machines: tuple[str, str], message: str):
    """A pod network that carries no multicast is told once, between machines or within one."""
    found = [
        member(name, machine, mode="none", interface=None)
        for name, machine in zip("ab", machines, strict=True)
    ]
    looks = {"a": seen("a", sends=True), "b": seen("b", sends=machines[0] != machines[1])}
    (finding,) = graph(found, looks).problems
    assert (finding.message, finding.is_error) == (message, False)
    assert finding.remedy.startswith("set `network`")


def test_forbidden():
    """Where exec is forbidden that is said once, and is no error: nothing is known."""
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


class Refusing:
    """A cluster in which nobody may look into pods."""

    def exec(self, *_: Any, **__: Any) -> int:
        raise Forbidden("pods is forbidden")


def test_looks_that_are_refused():
    """The refusal of the cluster becomes a reason in words."""
    found = look(Refusing(), [member("a")])  # type: ignore[arg-type]
    assert found["a"].problem.startswith("commands in pods are not allowed")


class Slow:
    """A cluster in which one pod starts to hear late."""

    def exec(self, namespace: str, pod: str, *_: Any, stdout: Any, stdin: Any, **__: Any) -> int:
        if pod == "late":
            time.sleep(0.5)
        stdout.write(b'{"interfaces": {}, "down": [], "participants": [], "routers": []}\n')
        for _ in range(2):  # the script, and the line that ends it
            stdin.readline()
        stdout.write(b'{"participants": [], "beacons": {}, "servers": {}, "sent": 0}\n')
        return 0


class Here:
    """A cluster whose pods are this machine."""

    def exec(
        self,
        namespace: str,
        pod: str,
        command: Any,
        *,
        stdin: Any,
        stdout: Any,
        stderr: Any,
        **_: Any,
    ) -> int:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with subprocess.Popen(
            [sys.executable, *command[1:]], stdin=stdin, cwd="/", env={}, **pipes
        ) as process:
            for line in process.stdout or ():
                stdout.write(line)
            stderr.write(process.stderr.read() if process.stderr else b"")
        return process.returncode


@pytest.mark.programs
def test_the_check_is_sent_into_the_pod():
    """Nothing of it is in the image or mounted, so a pod of any version can be examined."""
    alone = attrs.evolve(member("a"), interface=None, domain=97)
    found = look(Here(), [alone], seconds=0.2)  # type: ignore[arg-type]
    assert found["a"].problem == ""
    assert found["a"].interfaces is not None
    assert found["a"].sends


def test_a_late_pod(monkeypatch: pytest.MonkeyPatch):
    """A pod that hears when the others have ended tells nothing about whom it hears."""
    monkeypatch.setattr(graph_looks, "START", 0.1)
    found = look(Slow(), [member("late"), member("soon")], seconds=0.1)  # type: ignore[arg-type]
    assert found["late"].problem.startswith("its container did not answer in time")
    assert found["soon"].problem == ""


def test_not_running():
    """A container that does not run is not looked into."""
    found = look(Refusing(), [member("a", running=False)])  # type: ignore[arg-type]
    assert found["a"].problem == "its container does not run"


def test_a_machine_that_is_lost_is_not_asked():
    """Nothing is sent to it, so that nothing waits for its answer."""
    gone = attrs.evolve(member("a"), machine="node1", reachable=False)
    found = look(Refusing(), [gone])  # type: ignore[arg-type]
    assert found["a"].problem == "Kubernetes cannot reach the machine node1"


class Cut:
    """A cluster whose API server cannot reach the machine of a pod that it calls ready."""

    def exec(self, *_: Any, **__: Any) -> int:
        url = 'Post "https://10.0.0.1:10250/exec/robots/a/ros-node?command=python3"'
        raise ClusterError(f"Internal error: {url}: dial tcp 10.0.0.1:10250: connect: no route")


def test_a_kubelet_without_a_route_is_told_in_few_words():
    """Not the URL with the whole command."""
    found = look(Cut(), [member("a")])  # type: ignore[arg-type]
    assert found["a"].problem == "the API server cannot reach its machine (no route)"


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[DiscoveryGraph | None]:
    """What successive looks find; the last one for ever."""
    found: list[DiscoveryGraph | None] = []

    def glance(*_: Any) -> DiscoveryGraph | None:
        return found.pop(0) if len(found) > 1 else found[0]

    monkeypatch.setattr(graphs, "look_briefly", glance)
    monkeypatch.setattr(graphs, "AGAIN", 0.0)
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
    with pytest.raises(graphs.GraphError) as caught:
        run_check(Recorder())
    assert caught.value.exit_code == 1
    assert caught.value.message.startswith("app in robots is deployed, but")
    assert caught.value.details == ("node2 is deaf; look [deaf]",)


def test_what_a_busy_machine_may_explain_is_looked_at_again(looks: list[DiscoveryGraph | None]):
    """A second look decides; what no time explains is told at once."""
    looks += [WRONG, GOOD]
    assert graphs.survey(None, RELEASE) is GOOD  # type: ignore[arg-type]
    lacking = Problem((), "one has no net1", "no-interface", remedy="delete it")
    wrong = DiscoveryGraph((), (), (lacking,))
    looks[:] = [wrong, GOOD]
    assert graphs.survey(None, RELEASE) is wrong  # type: ignore[arg-type]
    looks[:] = [DOUBT, GOOD]
    assert graphs.survey(None, RELEASE) is DOUBT  # type: ignore[arg-type]


def test_check_ends_well_where_the_last_look_does(
    looks: list[DiscoveryGraph | None], monkeypatch: pytest.MonkeyPatch
):
    """The look that decides is the longer one."""
    monkeypatch.setattr(graphs, "PATIENCE", 0.0)
    looks += [WRONG, WRONG, GOOD]
    run_check(Recorder())


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
