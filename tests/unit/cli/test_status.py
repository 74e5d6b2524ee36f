"""How results look: status for people and for scripts."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Any

import attrs
import click
import pytest

from rigel_exporter.expecting import BROKEN, OK, Finding
from rigel_graph.discovery.findings import DiscoveryGraph, PodGraph
from rigel_graph.expectations import Verdict
from rigel_graph.status import describe
from rigel_graph.types import GateStatus, NameConflict, WaitingNode
from rigel_k8s.cli import tables
from rigel_k8s.cli.status import ORPHAN, headline, status_json, status_text
from rigel_k8s.cli.tables import age
from rigel_k8s.commands.status import Status
from rigel_k8s.problems import Problem
from rigel_k8s.release.status import (
    AWAY,
    UNSEEN,
    PodStatus,
    ReleaseStatus,
    RolledBack,
    WorkloadStatus,
)
from rigel_k8s.release.types import ReleaseId

NOW = datetime(2026, 1, 2, 12, 0, tzinfo=timezone.utc)
DIGEST = "sha256:" + "ab" * 32

TALKER = WorkloadStatus(
    "Deployment",
    "talker",
    1,
    1,
    True,
    "1 of 1 ready",
    (
        PodStatus(
            "talker-1", "node1", "10.0.0.1", "Running", True, 0, "", "2026-01-02T11:58:00Z", "r/t:1"
        ),
    ),
    {"rigel-k8s/ros-name": "/talker"},
)
LISTENER = WorkloadStatus(
    "Deployment",
    "listener",
    0,
    1,
    False,
    "0 of 1 ready; container ros-node exited with code 1",
    (
        PodStatus(
            "listener-2",
            "node2",
            "10.0.0.2",
            "Running",
            False,
            3,
            "Readiness probe failed: no ROS node of this pod is registered",
            "2026-01-01T12:00:00Z",
            f"r/l:1@{DIGEST}",
        ),
        PodStatus("listener-1", "", "", "Terminating", False, 0, "old", "2026-01-01T12:00:00Z"),
    ),
)
WAITING = WorkloadStatus("Deployment", "camera", 0, 1, False, "no pod can be made: quota", ())


GRAPH = DiscoveryGraph(
    (PodGraph("talker-1", "node1", "macvlan", 0, "net1", "10.1.0.5", ("camera-1",), 2),),
    (("node2", "node1"),),
    (
        Problem(
            (), "multicast from node2 does not reach node1", "deaf", remedy="look at the switch"
        ),
    ),
)


def release(*workloads: WorkloadStatus, revision: int = 3, state: str = "good") -> ReleaseStatus:
    return ReleaseStatus(ReleaseId("robots", "app"), revision, state, workloads)


def see(state: ReleaseStatus, **seen: Any) -> Status:
    """Return a status with what the graph's guest adds to it."""
    return Status(state, [describe(state, **seen)])


def test_a_revision_does_not_still_run_beside_itself() -> None:
    """Someone has changed an image by hand, and the new pod does not start."""
    stuck = attrs.evolve(LISTENER, old_runs=True, kinds=("crash",))
    for good, ending in ((3, "revision 3"), (2, "revision 3; revision 2 still runs")):
        assert headline(attrs.evolve(release(stuck), good=good)).endswith(ending)


def test_the_revision_of_a_part_of_the_robot_is_named_with_it() -> None:
    """Its other nodes run the new one: a failed update leaves a mixture."""
    stuck = attrs.evolve(LISTENER, old_runs=True, kinds=("crash",))
    text = headline(attrs.evolve(release(stuck, TALKER, state="failed"), good=2))
    assert text.endswith("revision 3 (failed); of listener revision 2 still runs")


def test_status_for_people() -> None:
    """A row a pod, and below why something is not ready; a pod on its way out needs no reason."""
    text = status_text(Status(release(LISTENER, TALKER, WAITING, state="pending")), NOW)
    assert click.unstyle(text) == (
        "release app in namespace robots, revision 3 (pending)\n"
        "\n"
        "NODE      ROS NAME  READY  POD         ON     RESTARTS  AGE  IMAGE\n"
        "listener  -         0/1    listener-2  node2  3         24h  r/l:1@sha256:abababa\n"
        "listener  -         0/1    listener-1  -      0         24h  -\n"
        "talker    /talker   1/1    talker-1    node1  0         2m   r/t:1\n"
        "camera    -         0/1    -           -      -         -    -\n"
        "\n"
        "listener: 0 of 1 ready; container ros-node exited with code 1\n"
        "camera: no pod can be made: quota\n"
        "listener-2: Readiness probe failed: no ROS node of this pod is registered"
    )


@pytest.mark.parametrize(("length", "whole"), [(24, True), (34, False)])
def test_pods_of_one_node_can_be_told_apart(
    length: int,
    whole: bool,  # noqa: FBT001
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In a narrow terminal, too: other columns are left out, and only then names are narrowed."""
    monkeypatch.setattr(tables, "find_room", lambda _: 80)
    name = "n" * length
    ends = ("7d8f9c6b5-x2x4z", "5cb9b998c-92fsp")
    pods = [attrs.evolve(TALKER.pods[0], name=f"{name}-{end}") for end in ends]
    one, several = (attrs.evolve(TALKER, name=name, pods=tuple(pods[:n])) for n in (1, 2))
    heads = click.unstyle(status_text(Status(release(one)), NOW)).splitlines()[2].split()
    assert "POD" not in heads
    assert {"RESTARTS", "ON"} <= {*heads}
    rows = click.unstyle(status_text(see(release(several), graph=GRAPH), NOW)).splitlines()[2:5]
    assert max(map(len, rows)) <= 80
    for row, end in zip(rows[1:], ends, strict=True):
        assert row.startswith(f"{name}  1/1")
        assert (f"{name}-{end}" in row) is whole
        assert f"n-{end}" in row


def test_a_pod_that_cannot_end_is_told() -> None:
    """Its machine is out of reach: it may still talk there while another one has its place."""
    (pod,) = TALKER.pods
    words = "Kubernetes cannot reach the machine node2, where the pod cannot be ended"
    old = attrs.evolve(
        pod, name="talker-0", phase="Terminating", ready=False, kind=AWAY, message=words
    )
    text = status_text(Status(release(attrs.evolve(TALKER, pods=(pod, old)))), NOW)
    assert click.unstyle(text).splitlines()[-1] == f"talker-0: {words}"


def test_a_task_is_done() -> None:
    """Its pod has ended as it should, and is no reason to look."""
    (pod,) = TALKER.pods
    done = attrs.evolve(pod, name="spawn-1", phase="Succeeded", ready=False)
    task = WorkloadStatus("Job", "spawn", 1, 1, True, "complete", (done,))
    lines = click.unstyle(status_text(Status(release(TALKER, task)), NOW)).splitlines()
    assert lines[4].split()[:4] == ["spawn", "-", "done", "spawn-1"]
    assert lines[-2:] == ["", "2 of 2 ready"]


def test_nothing_runs() -> None:
    """Said in words."""
    text = status_text(Status(release(revision=0, state="")), NOW)
    assert text == "release app in namespace robots: no revision\n\nnothing runs"


def test_a_revision_that_may_not_be_seen_is_not_called_missing() -> None:
    """A viewer may not list Secrets, and revisions are Secrets."""
    found = ReleaseStatus(ReleaseId("robots", "app"), 0, UNSEEN, ())
    assert "its revision cannot be read (the right to list secrets is missing)" in headline(found)


def test_orphans_and_the_way_out() -> None:
    """What roscore has forgotten never comes back by itself: the command that helps is told."""
    (pod, old) = LISTENER.pods
    orphan = attrs.evolve(pod, kind=ORPHAN)
    text = status_text(Status(release(attrs.evolve(LISTENER, pods=(orphan, old)), TALKER)), NOW)
    assert text.endswith(
        "roscore has restarted and forgotten listener. It comes back with\n"
        "  rigel -n robots restart --release app listener"
    )


def test_graph_in_the_table() -> None:
    """A release with DDS shows interface, address and in how many pods each node is discovered."""
    lines = status_text(see(release(TALKER, WAITING), graph=GRAPH), NOW).splitlines()
    heads = "NODE    ROS NAME  READY  POD       ON     INTERFACE  ADDRESS   DISCOVERED  RESTARTS"
    assert lines[2].startswith(heads)
    assert "node1  net1       10.1.0.5  1/2         0" in lines[3]
    assert click.unstyle(lines[4]).split() == ["camera", "-", "0/1", *["-"] * 8]
    assert "multicast from node2 does not reach node1; look at the switch [deaf]" in lines[-1]
    assert status_json(see(release(TALKER), graph=GRAPH))["graph"] == {
        "ok": False,
        "deaf": [{"from": "node2", "to": "node1"}],
        "problems": [
            {
                "path": (),
                "message": "multicast from node2 does not reach node1",
                "kind": "deaf",
                "severity": "error",
                "remedy": "look at the switch",
                "subjects": (),
            }
        ],
        "pods": [attrs.asdict(GRAPH.pods[0])],
    }


def test_a_graph_in_order() -> None:
    """A graph without findings adds columns and no line; a remedy of several stands once, the kind
    of each behind it, for `rigel explain`.
    """
    order = attrs.evolve(GRAPH, problems=(), deaf=())
    assert (
        click.unstyle(status_text(see(release(TALKER), graph=order), NOW)).splitlines()[-1]
        == "1 of 1 ready"
    )
    twice = attrs.evolve(GRAPH, problems=GRAPH.problems * 2)
    text = status_text(see(release(TALKER), graph=twice), NOW)
    assert text.count("look at the switch") == 1
    assert text.count("[deaf]") == 2


def test_clocks_that_differ() -> None:
    """A line for each machine, and what to do once; nothing else changes."""
    remedy = "run chrony"
    wrong = [Problem((), f"clocks: {n}", "clocks-differ", "warning", remedy=remedy) for n in "ab"]
    text = click.unstyle(status_text(see(release(TALKER), clocks=wrong), NOW))
    assert text.splitlines()[-2:] == [
        "clocks: a [clocks-differ]",
        "clocks: b; run chrony [clocks-differ]",
    ]
    assert status_json(see(release(TALKER), clocks=wrong))["clocks"][0]["message"] == "clocks: a"
    assert status_json(Status(release(TALKER)))["clocks"] is None


@pytest.mark.parametrize(("ready", "word"), [(True, "restarted"), (False, "stopped")])
def test_a_restart_by_the_liveness_probe_is_a_line(ready: bool, word: str) -> None:  # noqa: FBT001
    """A count of restarts does not show why; while it waits in between, it is not restarted yet."""
    why = "/lidar has published nothing on /scan for 2.4 s"
    pod = attrs.evolve(TALKER.pods[0], ready=ready, stopped="2026-01-02T11:59:40Z", not_alive=why)
    text = status_text(Status(release(attrs.evolve(TALKER, pods=(pod,)))), NOW)
    line = f"talker-1: {word} by its liveness probe 20s ago: {why}"
    assert line in " ".join(click.unstyle(text).split())


@pytest.mark.parametrize(
    ("crashed", "shown"),
    [("2026-01-02T11:59:40Z", True), ("2026-01-02T10:00:00Z", False), ("", False)],
)
def test_a_crash_of_the_last_hour_is_a_line(crashed: str, shown: bool) -> None:  # noqa: FBT001
    """A pod that is ready between its crashes looks well, but for a number."""
    pod = attrs.evolve(TALKER.pods[0], crashed=crashed, crash="container c exited with code 1")
    text = status_text(Status(release(attrs.evolve(TALKER, pods=(pod,)))), NOW)
    line = "talker-1: started again 20s ago: container c exited with code 1"
    assert (line in " ".join(click.unstyle(text).split())) is shown


@pytest.mark.parametrize(("cause", "end"), [("/scan: rate 3/s", ": /scan: rate 3/s"), ("", "")])
def test_an_update_that_was_rolled_back_is_a_line(cause: str, end: str) -> None:
    """All is ready again, and yet what runs is not what was deployed last."""
    found = attrs.evolve(release(TALKER), rolled_back=RolledBack(2, 1, cause))
    text = click.unstyle(status_text(Status(found), NOW))
    assert text.splitlines()[-1] == f"revision 2 was rolled back to revision 1{end}"
    expected = {"revision": 2, "to": 1, "cause": cause}
    assert status_json(Status(found))["rolled_back"] == expected


def test_a_topic_that_is_not_as_expected_is_a_line() -> None:
    """In the words of `rigel expect`; what is as expected is none."""
    slow = Verdict("/scan", Finding("rate", BROKEN, "8..12/s", "3.1/s"))
    good = Verdict("/scan", Finding("publishers", OK, "1", "1"))
    text = click.unstyle(status_text(see(release(TALKER), expect=[slow, good]), NOW))
    assert text.split("\n\n")[-1] == "/scan: rate 3.1/s, expected 8..12/s"
    found = status_json(see(release(TALKER), expect=[slow]))["expect"]
    expected = {"topic": "/scan", "what": "rate", "state": BROKEN, "expected": "8..12/s"}
    assert found == [{**expected, "measured": "3.1/s"}]


def test_status_for_scripts() -> None:
    """The shape that docs/cli.md promises."""
    found = status_json(Status(release(TALKER)))
    (workload,) = found.pop("workloads")
    assert found == {
        "release": "app",
        "namespace": "robots",
        "revision": 3,
        "revision_status": "good",
        "good_revision": 0,
        "rolled_back": None,
        "missing": [],
        "changed": [],
        "ready": True,
        "graph": None,
        "gate": None,
        "clocks": None,
        "expect": None,
    }
    (pod,) = workload.pop("pods")
    assert workload == {
        "kind": "Deployment",
        "name": "talker",
        "ros_name": "/talker",
        "ready": 1,
        "desired": 1,
        "done": True,
        "message": "1 of 1 ready",
        "old_runs": False,
        "drift": [],
        "development": None,
    }
    assert pod == {
        "name": "talker-1",
        "node": "node1",
        "ip": "10.0.0.1",
        "phase": "Running",
        "ready": True,
        "restarts": 0,
        "message": "",
        "created": "2026-01-02T11:58:00Z",
        "image": "r/t:1",
        "kind": "",
        "stopped": "",
        "not_alive": "",
        "crashed": "",
        "crash": "",
    }
    assert status_json(Status(release(TALKER, WAITING)))["ready"] is False


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0s"),
        (119, "119s"),
        (120, "2m"),
        (7200, "2h"),
        (86400, "24h"),
        (172800, "2d"),
        (-5, "0s"),
    ],
)
def test_ages(seconds: int, text: str) -> None:
    """Two digits say enough; a clock that goes wrong gives no negative age."""
    then = (NOW - timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%SZ")
    assert age(then, NOW) == text
    assert age("", NOW) == "-"


def lines_of(**knows: Any) -> list[str]:
    """Return what status says below the table of a release whose gate knows this."""
    text = click.unstyle(status_text(see(release(TALKER), gate=GateStatus(**knows)), NOW))
    return text.split("\n\n", 2)[2].splitlines() if text.count("\n\n") > 1 else []


def test_status_says_who_lost_its_name_to_whom() -> None:
    """Pods by their names, others by their address, and the way out."""
    lost = NameConflict("/talker", "http://10.0.0.1:4001/", "http://192.168.7.5:4002/", 40.4)
    assert lines_of(conflicts=(lost,)) == [
        "/talker: pod talker-1 lost its name to 192.168.7.5 (no pod of this release) 40 s ago;"
        " ROS 1 allows one node of a name: stop one of the two, or rename it"
    ]


def test_status_names_what_the_gate_could_not_restore_or_keep() -> None:
    """With the registration to blame; calls that wait have their reason."""
    assert lines_of(
        has_master=False,
        blocked="the new master cannot be given its registrations: bug",
        refused=("service /ask of /evil at http://10.0.0.2:1/: no",),
        unkept=("the memory is not kept in the cluster: it has more than 9 bytes",),
        notes=("the file of the pod is not used",),
    ) == [
        "the new master cannot be given its registrations: bug; calls to the master wait until it"
        " succeeds",
        "roscore did not accept again the service /ask of /evil at http://10.0.0.2:1/: no; restart"
        " the pod of its node",
        "the memory is not kept in the cluster: it has more than 9 bytes; a new ros-master pod"
        " would not have the latest registrations and parameters",
        "the file of the pod is not used",
    ]


def test_status_says_what_the_gate_waits_for() -> None:
    """A newcomer, a node that is silent, a roscore that is away; nothing where all is well."""
    waits = WaitingNode("/talker", "http://10.0.0.9:4001/", "http://10.0.0.1:4002/")
    assert lines_of(waiting=(waits,), silent=("/camera",), has_master=False) == [
        "roscore does not answer its gate; calls to the master wait until it does",
        "/talker: 10.0.0.9 (no pod of this release) waits to take over from pod talker-1",
        "/camera has not answered since roscore restarted; it is registered once it does",
    ]
    assert lines_of() == ["1 of 1 ready"]
    assert lines_of(problem="no python3") == [
        "cannot reach the gate in front of roscore: no python3"
    ]
