"""The state of a node and its cause, from what Kubernetes says of its pods."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.marks import FIELD_MANAGER, OPTIONAL_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.rollout.view import find_related
from rigel_k8s.release.status import ReleaseStatus, describe_workload
from rigel_k8s.release.types import ReleaseId
from rigel_ui.nodes import node_entry, release_entry

T0, T1, T2 = (f"2026-01-01T00:00:0{second}Z" for second in range(3))
RUNS = {"name": "node", "ready": False, "restartCount": 0, "state": {"running": {"startedAt": T1}}}
ENDED = {"exitCode": 3, "reason": "Error", "message": "no camera"}


def deployment(*, available: int = 0, replicas: int = 1, **notes: str) -> Manifest:
    notes[ROS_NAME_ANNOTATION] = "/talker"
    return {
        "kind": "Deployment",
        "apiVersion": "apps/v1",
        "metadata": {"name": "talker", "uid": "d", "annotations": notes, "generation": 1},
        "spec": {"replicas": replicas},
        "status": {
            "observedGeneration": 1,
            "replicas": replicas,
            "updatedReplicas": replicas,
            "availableReplicas": available,
        },
    }


def pod(
    status: dict[str, Any] | None = None, *, ready: str = "False", since: str = T0, **more: Any
) -> Manifest:
    conditions = [{"type": "Ready", "status": ready, "reason": "x", "lastTransitionTime": since}]
    meta = {
        "name": "talker-1",
        "uid": "p",
        "ownerReferences": [{"uid": "rs", "controller": True}],
        "creationTimestamp": T0,
    }
    return {
        "kind": "Pod",
        "metadata": meta,
        "spec": {"nodeName": "robot", "containers": [{"name": "node", "image": "a:1"}]},
        "status": {"phase": "Running", "conditions": conditions, "containerStatuses": [RUNS],
                   **(status or {})},
        **more,
    }  # fmt: skip


def entry(
    live: Manifest, pods: list[Manifest], events: list[Manifest] | None = None, **more: Any
) -> dict[str, Any]:
    owner = {"uid": "d", "controller": True}
    replica_set = {"metadata": {"name": "rs", "uid": "rs", "ownerReferences": [owner]}}
    related = find_related([replica_set], pods, events or [])
    return node_entry(describe_workload(live, related), pods, **more)


def warning(reason: str, message: str) -> Manifest:
    return {"reason": reason, "message": message, "involvedObject": {"uid": "p"}}


PROBE = warning("Unhealthy", "Readiness probe failed: /talker does not answer")


def test_a_node_is_ready() -> None:
    found = entry(deployment(available=1), [pod(ready="True")])
    assert (found["state"], found["cause"]) == ("ready", "")
    assert (found["name"], found["machine"], found["image"]) == ("/talker", "robot", "a:1")


def test_a_node_without_pods_on_purpose_is_stopped() -> None:
    assert entry(deployment(replicas=0), [])["state"] == "stopped"


@pytest.mark.parametrize(
    ("change", "state", "words"),
    [
        ({"replicas": 0}, "stopped", "someone has scaled it to 0 pods"),
        ({"paused": True}, "unready", "someone has paused its roll-outs"),
    ],
)
def test_what_someone_has_stopped_is_not_well(
    change: dict[str, Any], state: str, words: str
) -> None:
    """As in `rigel status`."""
    live = deployment(available=1, replicas=change.get("replicas", 1))
    live["spec"] |= change
    ours = {"f:spec": {"f:template": {}}}
    live["metadata"]["managedFields"] = [
        {"manager": FIELD_MANAGER, "operation": "Apply", "fieldsV1": ours}
    ]
    workload = describe_workload(live, find_related([], []))
    found = node_entry(workload, [])
    assert (found["state"], found["brief"]) == (state, found["cause"])
    assert found["brief"].startswith(words)
    whole = ReleaseStatus(ReleaseId("n", "demo"), 1, "good", (workload,))
    shown = release_entry(whole, {"talker": found}, changing="")
    assert (shown["ready"], shown["well"]) == (0, False)


@pytest.mark.parametrize(
    ("job", "ready", "state"),
    [
        ({"active": 1}, "True", "ready"),
        ({"active": 1}, "False", "starting"),
        ({"succeeded": 1, "conditions": [{"type": "Complete", "status": "True"}]}, "False", "done"),
    ],
)
def test_a_task_is_ready_while_it_runs_and_then_done(
    job: dict[str, Any], ready: str, state: str
) -> None:
    made = deployment()
    made |= {"kind": "Job", "apiVersion": "batch/v1", "spec": {}, "status": job}
    owned = pod(ready=ready)
    owned["metadata"] = {**owned["metadata"], "ownerReferences": [{"uid": "d", "controller": True}]}
    found = entry(made, [owned], rolling=True)
    assert found["state"] == state
    release = release_entry(
        ReleaseStatus(ReleaseId("n", "r"), 1, "good", ()), {"a": found}, changing=""
    )
    assert release["well"] == (state != "starting")


def test_a_crashed_node_has_its_last_words() -> None:
    """In the words of `rigel status`."""
    ended = {**RUNS, "state": {"waiting": {"reason": "CrashLoopBackOff"}}, "restartCount": 2}
    found = entry(
        deployment(), [pod({"containerStatuses": [{**ended, "lastState": {"terminated": ENDED}}]})]
    )
    assert found["state"] == "crashed"
    words = "container node exited with code 3 (no camera)"
    assert found["cause"] == f"0 of 1 ready; {words}", "once"
    assert found["brief"] == words, "what has little room begins with the cause"


def test_a_node_whose_update_fails_is_not_crashed() -> None:
    """The version before still runs: the page says which one, and why the new one does not."""
    ended = {**RUNS, "state": {"waiting": {"reason": "CrashLoopBackOff"}}, "restartCount": 2}
    live = deployment(available=1)
    live["status"] |= {"replicas": 2, "updatedReplicas": 1}
    pods = [pod({"containerStatuses": [{**ended, "lastState": {"terminated": ENDED}}]})]
    found = entry(live, pods, good=3)
    assert found["state"] == "outdated"
    words = "container node exited with code 3 (no camera)"
    assert found["cause"] == f"revision 3 still runs; {words}"
    assert found["brief"] == words


def test_a_node_that_runs_again_stays_crashed_for_a_while() -> None:
    """A container without a probe is ready as soon as it runs."""
    again = {**RUNS, "ready": True, "restartCount": 1, "lastState": {"terminated": ENDED}}
    pods = [pod({"containerStatuses": [again]}, ready="True")]
    found = entry(deployment(available=1), pods, crashed=True)
    assert found["state"] == "crashed"
    assert found["brief"] == "container node exited with code 3 (no camera)"
    assert found["cause"] == f"it runs again; {found['brief']}"
    assert entry(deployment(available=1), pods)["state"] == "ready"


def test_a_node_that_never_was_ready_is_starting_while_a_rollout_goes_on() -> None:
    """With the words of its probe; afterwards it should have been ready."""
    during = entry(deployment(), [pod()], [PROBE], rolling=True)
    assert during["state"] == "starting"
    assert "/talker does not answer" in during["cause"]
    assert entry(deployment(), [pod()], [PROBE])["state"] == "unready"
    assert entry(deployment(), [pod()])["state"] == "starting"


def test_a_node_that_was_ready_and_is_not_has_its_probes_words() -> None:
    """During a roll-out, too."""
    found = entry(deployment(), [pod(since=T2)], [PROBE], rolling=True)
    assert found["state"] == "unready"
    assert found["cause"].endswith("Readiness probe failed: /talker does not answer")


UNPULLED = {**RUNS, "state": {"waiting": {"reason": "ErrImagePull", "message": "no such tag"}}}
UNPLACED = {"type": "PodScheduled", "status": "False", "message": "0/1 nodes"}


@pytest.mark.parametrize(
    ("status", "events", "words"),
    [
        (
            {"containerStatuses": [{**UNPULLED, "image": "a:1"}]},
            [],
            "image a:1 cannot be pulled: no such tag",
        ),
        (
            {"phase": "Pending", "containerStatuses": [], "conditions": [UNPLACED]},
            [],
            "no machine can run the pod: 0/1 nodes",
        ),
        (
            {"phase": "Pending", "containerStatuses": []},
            [warning("FailedMount", "no volume")],
            "FailedMount: no volume",
        ),
    ],
)
def test_a_node_that_cannot_start_is_blocked(
    status: dict[str, Any], events: list[Manifest], words: str
) -> None:
    """It is not merely starting: waiting does not help."""
    found = entry(deployment(), [pod(status)], events, rolling=True)
    assert found["state"] == "blocked"
    assert words in found["cause"]


def test_a_node_on_a_lost_machine_is_unreachable() -> None:
    """It may still run there."""
    lost = [
        {"type": "Ready", "status": "False"},
        {"type": "ContainersReady", "status": "True"},
    ]
    found = entry(deployment(), [pod({"conditions": lost})])
    assert found["state"] == "unreachable"
    assert "cannot reach the machine robot" in found["cause"]


def test_a_node_keeps_its_machine_between_two_pods() -> None:
    """Its box must not jump while a pod is replaced."""
    assert entry(deployment(), [], machine="robot")["machine"] == "robot"


def test_a_remedy_is_shown_only_while_something_is_wrong() -> None:
    notes = {REMEDY_ANNOTATION: "do this"}
    assert entry(deployment(**notes), [pod()])["remedy"] == "do this"
    assert entry(deployment(available=1, **notes), [pod(ready="True")])["remedy"] == ""


def test_a_release_is_well_without_what_is_optional() -> None:
    """As `rigel status` says."""

    def whole(**notes: str) -> dict[str, Any]:
        workload = describe_workload(deployment(**notes), find_related([], []))
        found = ReleaseStatus(ReleaseId("n", "demo"), 1, "good", (workload,))
        return release_entry(found, {"talker": node_entry(workload, [])}, changing="")

    assert whole()["well"] is False
    optional = whole(**{OPTIONAL_ANNOTATION: "true"})
    assert optional["well"] is True
    assert (optional["ready"], optional["nodes"], optional["counts"]["starting"]) == (0, 1, 1)
