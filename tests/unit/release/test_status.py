"""What is said of a release's pods."""

from __future__ import annotations

from typing import Any

import click
import pytest

from rigel_k8s.cli.status import status_text
from rigel_k8s.commands.status import Status
from rigel_k8s.errors import RolloutFailed
from rigel_k8s.release.rollout import wait
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.rollout.view import find_related
from rigel_k8s.release.status import AWAY, describe_pod, describe_workload, status
from tests.support.clock import leap_when_shown
from tests.support.controllers import Controllers, running
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, desired, ref, workload
from tests.support.releases import deploy

UNREADY = {"type": "Ready", "status": "False"}
POD: dict[str, Any] = {
    "kind": "Pod",
    "metadata": {"name": "talker-1", "uid": "u"},
    "spec": {"containers": [{"name": "ros-node", "image": "a"}]},
    "status": {"phase": "Running", "conditions": [UNREADY]},
}


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("Readiness probe failed: /talker is an orphan: restart this pod [orphan]\n", "orphan"),
        ("Readiness probe failed: /talker [x] hangs", ""),
    ],
)
def test_the_kind_that_a_probe_names_is_a_value(said: str, kind: str) -> None:
    """Nobody searches a sentence for it."""
    event = {"reason": "Unhealthy", "message": said, "involvedObject": {"uid": "u"}}
    found = describe_pod(POD, [event])
    assert (found.kind, found.message) == (kind, " ".join(said.split()))


def test_living_pods_come_before_those_that_end() -> None:
    """The pod of the present version is the first line, whatever its name."""
    owners = [{"controller": True, "uid": "w"}]
    old, new = (
        {**POD, "metadata": {"name": name, "uid": name, "ownerReferences": owners}}
        for name in ("a-old", "b-new")
    )
    old["metadata"]["deletionTimestamp"] = "2026-01-01T00:00:00Z"
    talker = {**workload(), "metadata": {"name": "talker", "uid": "w"}}
    found = describe_workload(talker, find_related([], [old, new]))
    assert [pod.name for pod in found.pods] == ["b-new", "a-old"]


#: As the node controller leaves them when it has lost a machine.
LOST = [UNREADY, {"type": "ContainersReady", "status": "True"}]


@pytest.mark.parametrize(
    ("conditions", "kind"),
    [
        (LOST, AWAY),
        ([{**UNREADY, "reason": "ContainersNotReady"}, {**LOST[1], "status": "False"}], ""),
        ([{**UNREADY, "reason": "ReadinessGatesNotReady"}, LOST[1]], ""),
        ([{**UNREADY, "status": "True"}, LOST[1]], ""),
    ],
)
def test_a_lost_machine_is_told_from_what_its_kubelet_says(
    conditions: list[dict[str, str]], kind: str
) -> None:
    """Without the right to see machines: only the node controller takes Ready alone."""
    pod = {
        **POD,
        "spec": {**POD["spec"], "nodeName": "robot-1"},
        "status": {"phase": "Running", "conditions": conditions},
    }
    found = describe_pod(pod, [])
    assert found.kind == kind
    assert ("cannot reach the machine robot-1" in found.message) is (kind == AWAY)
    ending = {**pod, "metadata": {**POD["metadata"], "deletionTimestamp": "2026-01-01T00:00:00Z"}}
    assert describe_pod(ending, []).message.endswith("cannot be ended") is (kind == AWAY)


WORDS = "[rospack] Error: package 'bott' not found"


def rolling(name: str, image: str) -> dict[str, Any]:
    made = workload(name, image=image)
    made["spec"]["strategy"] = {"type": "RollingUpdate"}
    return made


def crash_new(pod: dict[str, Any]) -> dict[str, Any]:
    """Let the pods of app:2 crash, and those of app:1 run."""
    if pod["spec"]["containers"][0]["image"] == "app:1":
        return running(pod)
    ended = {"terminated": {"exitCode": 1, "reason": "Error", "message": f"{WORDS}\n"}}
    waits = {"waiting": {"reason": "CrashLoopBackOff"}}
    container = {"name": "node", "ready": False, "state": waits, "lastState": ended}
    return {
        "phase": "Running",
        "conditions": [UNREADY],
        "containerStatuses": [{**container, "restartCount": len(pod["metadata"]["name"])}],
    }


@pytest.fixture
def failed(fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch) -> RolloutFailed:
    """The error of an update of two nodes whose new pods crash, for one reason."""
    monkeypatch.setattr(wait, "EXPLAIN", 0.0)
    fake.store.controllers = Controllers(crash_new)
    names = ("driver", "filtered")
    deploy(desired(*(rolling(name, "app:1") for name in names)), fake, report=report)
    new = desired(*(rolling(name, "app:2") for name in names))
    both = [(name, "exited with code 1") for name in names]
    leap_when_shown(monkeypatch, report, Patience().crash, *both)
    with pytest.raises(RolloutFailed) as caught:
        deploy(new, fake, report=report)
    return caught.value


def test_a_failed_update_names_what_still_runs_first(failed: RolloutFailed) -> None:
    """Then the nodes that have one cause, with its words, once."""
    assert failed.message == (
        "the old version still runs (revision 1); driver, filtered did not become ready: "
        f"container node exited with code 1 ({WORDS})"
    )
    assert failed.details == ("    last words",)


def test_a_failed_update_of_one_node_names_those_that_are_new(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot is a mixture then; a rollback takes all back."""
    monkeypatch.setattr(wait, "EXPLAIN", 0.0)

    def crash_driver(pod: dict[str, Any]) -> dict[str, Any]:
        return crash_new(pod) if pod["metadata"]["name"].startswith("driver") else running(pod)

    fake.store.controllers = Controllers(crash_driver)
    names = ("driver", "filtered")
    deploy(desired(*(rolling(name, "app:1") for name in names)), fake, report=report)
    shown = (("driver", "exited with code 1"), ("filtered", "1 of 1 ready"))
    leap_when_shown(monkeypatch, report, Patience().crash, *shown)
    with pytest.raises(RolloutFailed) as caught:
        deploy(desired(*(rolling(name, "app:2") for name in names)), fake, report=report)
    assert caught.value.message.startswith(
        "the old version of driver still runs (revision 1), and the new one of filtered; driver did"
    )


def test_the_old_version_of_a_failed_update_without_a_cause_runs(
    fake: FakeCluster, report: Any
) -> None:
    """A program that runs and is never ready has none."""

    def start(pod: dict[str, Any]) -> dict[str, Any]:
        ready = pod["spec"]["containers"][0]["image"] == "app:1"
        return running(pod) if ready else {"phase": "Running", "conditions": [UNREADY]}

    fake.store.controllers = Controllers(start)
    deploy(desired(rolling("driver", "app:1")), fake, report=report)
    with pytest.raises(RolloutFailed):
        deploy(desired(rolling("driver", "app:2")), fake, report=report, timeout=0.5)
    head = click.unstyle(status_text(Status(status(fake, RELEASE)))).split("\n\n")[0]  # type: ignore[arg-type]
    assert head.endswith("revision 2 (failed); revision 1 still runs")


def test_the_status_of_a_failed_update_is_as_good_as_the_robot(
    fake: FakeCluster, failed: RolloutFailed
) -> None:
    """READY is each pod's; the version that runs comes first, and one cause is one line."""
    text = click.unstyle(status_text(Status(status(fake, RELEASE))))  # type: ignore[arg-type]
    head, table, reason = text.split("\n\n")
    assert head.endswith("revision 2 (failed); revision 1 still runs")
    rows = [line.split() for line in table.splitlines()[1:]]
    assert sorted((row[2], row[5] != "0") for row in rows) == [
        ("0/1", True),
        ("0/1", True),
        ("1/1", False),
        ("1/1", False),
    ]
    assert reason == (
        "driver, filtered: 0 of 1 new pod ready, the old version still runs; "
        f"container node exited with code 1 ({WORDS})"
    )


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("Startup probe errored and resulted in unknown state: rpc error: code = Unknown desc = "
         "failed to exec in container: container is in CONTAINER_EXITED state", False),
        ("Startup probe errored: exec: no running task found: task 1 not found", False),
        ('Startup probe errored and resulted in unknown state: failed to exec in container: failed '
         'to create exec "973aa7": cannot exec in a deleted state', False),
        ('Startup probe errored and resulted in unknown state: rpc error: code = NotFound desc = '
         'failed to exec in container: failed to create exec "384b": container not created: '
         'not found', False),
        ("Startup probe errored and resulted in unknown state: rpc error: code = Unknown desc = "
         'failed to exec in container: failed to start exec "384b": ttrpc: closed', False),
        ("Startup probe errored and resulted in unknown state: no such file: /app/check", True),
        ("Startup probe failed: ", False),
        ("Startup probe failed: /talker is not registered", True),
    ],
)  # fmt: skip
def test_a_probe_of_a_container_that_has_exited_says_nothing(message: str, shown: bool) -> None:  # noqa: FBT001
    event = {"reason": "Unhealthy", "message": message, "involvedObject": {"uid": "u"}}
    assert describe_pod(POD, [event]).message == (message if shown else "")


@pytest.mark.parametrize(
    ("time", "stopped"),
    [
        ("2026-01-01T12:00:19Z", True),
        ("2026-01-01T12:00:00Z", False),  # of the life before, which ended in the same second
        ("2026-01-01T12:00:30Z", False),  # of this life
    ],
)
def test_what_the_liveness_probe_reported_explains_a_restart(time: str, stopped: bool) -> None:  # noqa: FBT001
    """If it failed in the life that ended last: no other line repeats it."""
    life = {"startedAt": "2026-01-01T12:00:00Z", "finishedAt": "2026-01-01T12:00:20Z"}
    container = {"name": "c", "state": {"running": {}}, "lastState": {"terminated": life}}
    pod = {**POD, "status": {**POD["status"], "containerStatuses": [container]}}
    about = {"uid": "u", "fieldPath": "spec.containers{c}"}
    message = "Liveness probe failed: /lidar has published nothing\n"
    event = {"reason": "Unhealthy", "message": message, "involvedObject": about}
    found = describe_pod(pod, [{**event, "lastTimestamp": time}])
    assert found.stopped == (life["finishedAt"] if stopped else "")
    assert found.not_alive == ("/lidar has published nothing" if stopped else "")
    assert ("published nothing" in found.message) is not stopped


@pytest.mark.parametrize("ready", [True, False])
def test_the_last_crash_of_a_pod_that_is_ready_is_known(ready: bool) -> None:  # noqa: FBT001
    """Of one that is not ready it is the cause."""
    life = {"finishedAt": "2026-01-01T12:00:20Z", "exitCode": 1, "message": "RuntimeError: boom"}
    last = {"terminated": life}
    container = {"name": "c", "ready": ready, "state": {"running": {}}, "lastState": last}
    pod = {**POD, "status": {**POD["status"], "containerStatuses": [container]}}
    found = describe_pod(pod, [])
    assert (found.crashed, found.crash) == (
        ("2026-01-01T12:00:20Z", "container c exited with code 1 (RuntimeError: boom)")
        if ready
        else ("", "")
    )


def test_a_probe_that_could_not_run_is_no_news_where_the_cause_is_known() -> None:
    """Its container had just ended; the runtime's words for that are long."""
    ended = {"exitCode": 1, "reason": "Error", "message": "RuntimeError: boom"}
    container = {"name": "c", "ready": False, "state": {"terminated": ended}}
    pod = {**POD, "status": {**POD["status"], "containerStatuses": [container]}}
    text = "Startup probe errored and resulted in unknown state: rpc error: setns process"
    event = {"reason": "Unhealthy", "message": text, "involvedObject": {"uid": "u"}}
    assert (
        describe_pod(pod, [event]).message == "container c exited with code 1 (RuntimeError: boom)"
    )


def test_drift_is_a_line_of_the_status(fake: FakeCluster, report: Any) -> None:
    """Not a failure: the robot runs."""
    made = workload()
    del made["spec"]["replicas"]
    deploy(desired(made), fake, report=report)
    theirs = fake.as_manager("kubectl-patch")
    theirs.patch(ref("Deployment", "talker"), {"spec": {"replicas": 2}})
    fake.settle()
    found = status(fake, RELEASE)  # type: ignore[arg-type]
    assert [w.ok for w in found.workloads] == [True]
    assert click.unstyle(status_text(Status(found))).endswith(
        "1 of 1 ready\n\n"
        "talker was changed by kubectl-patch: replicas 2; `rigel run --adopt` undoes it"
    )
