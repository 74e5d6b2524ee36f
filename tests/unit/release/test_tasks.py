"""Jobs of a release: each runs once, is waited for, and runs again if it has changed or failed."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import RolloutFailed
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.development import restart
from rigel_k8s.release.difference import difference
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.rollout.readiness import readiness_without
from rigel_k8s.release.rollout.standing import Standing
from rigel_k8s.release.rollout.view import find_related
from rigel_k8s.release.status import status
from rigel_k8s.release.types import DeployOptions
from tests.support.controllers import Controllers, ended, running
from tests.support.fake_cluster import FakeCluster, make_refusal
from tests.support.manifests import RELEASE, desired, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, diff, rollback

JOB = ObjectRef("batch/v1", "Job", "n", "spawn")
WORDS = "loading\nRuntimeError: no controller arm\n"


def task(image: str = "app:1", **more: Any) -> dict[str, Any]:
    """Return a Job of the release."""
    made = workload("spawn", image, **more)
    template = made["spec"]["template"]
    template["spec"]["restartPolicy"] = "Never"
    del template["spec"]["containers"][0]["readinessProbe"]
    spec = {"backoffLimit": 0, "template": template}
    return {**made, "apiVersion": "batch/v1", "kind": "Job", "spec": spec}


class Machine:
    """A kubelet whose tasks end as they are told to, the others run."""

    def __init__(self) -> None:
        self.code: int | None = 0
        self.runs: list[str] = []

    def __call__(self, pod: dict[str, Any]) -> dict[str, Any]:
        if pod["spec"].get("restartPolicy") != "Never":
            return running(pod)
        if (pod.get("status") or {}).get("phase") in ("Succeeded", "Failed"):
            return dict(pod["status"])
        if pod["metadata"]["uid"] not in self.runs:
            self.runs.append(pod["metadata"]["uid"])
        return running(pod) if self.code is None else ended(pod, self.code, WORDS)


@pytest.fixture
def machine() -> Machine:
    return Machine()


@pytest.fixture
def cluster(machine: Machine) -> FakeCluster:
    made = FakeCluster()
    made.store.controllers = Controllers(machine)
    made.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
    return made


def test_a_deploy_waits_for_its_end_and_runs_it_once(cluster: Any, machine: Machine) -> None:
    """A deploy that changes nothing of it, or only other objects, runs it not again."""
    report = Recorder()
    assert deploy(desired(workload(), task()), cluster, report=report).status == "good"
    assert ("spawn", "complete", True) in report.states
    assert deploy(desired(workload(), task()), cluster, report=report).number == 1
    assert deploy(desired(workload(image="app:2"), task()), cluster, report=report).number == 2
    assert len(machine.runs) == 1


def test_a_changed_one_ends_before_its_successor_begins(cluster: Any, machine: Machine) -> None:
    """Kubernetes never changes the pods of a Job; a rollback runs the older one."""
    report = Recorder()
    cluster.store.controllers = Controllers(machine, ending={"spawn": 9})
    deploy(desired(task()), cluster, report=report)
    pods: list[set[str]] = []
    cluster.store.before = lambda verb, ref: (
        pods.append(cluster.names("Pod")) if (verb, ref) == ("apply", JOB) else None
    )
    first = cluster.objects[JOB]["metadata"]["uid"]
    plan = diff(desired(task("app:2")), cluster)
    [step] = plan.changes
    assert (step.action, step.replaces) == ("change", True)
    lines = difference(plan.steps).splitlines()
    changed = [
        line.split() for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")
    ]
    assert changed == [["-", "-", "image:", "app:1"], ["+", "-", "image:", "app:2"]]
    assert deploy(desired(task("app:2")), cluster, report=report).number == 2
    assert pods == [set()]
    assert cluster.objects[JOB]["metadata"]["uid"] != first
    assert len(machine.runs) == 2
    assert rollback(cluster, RELEASE, 1, report=report).status == "good"
    assert len(machine.runs) == 3


def test_a_failure_is_the_deploys_with_its_last_words(cluster: Any, machine: Machine) -> None:
    """The next deploy runs it again, though the Rigelfile is the same."""
    machine.code, report = 3, Recorder()
    with pytest.raises(RolloutFailed) as caught:
        deploy(desired(workload(), task()), cluster, report=report)
    assert caught.value.exit_code == 1
    assert caught.value.message == (
        "spawn did not succeed: container node exited with code 3 (RuntimeError: no controller arm)"
    )
    assert caught.value.hint is not None
    assert caught.value.hint.startswith("`rigel logs spawn` shows its output")
    found = {one.name: one for one in status(cluster, RELEASE).workloads}["spawn"]
    assert (found.done, found.kinds) == (False, ("failed",))
    assert found.message == (
        "failed; container node exited with code 3 (RuntimeError: no controller arm)"
    )
    machine.code = 0
    assert deploy(desired(workload(), task()), cluster, report=report).status == "good"
    assert len(machine.runs) == 2


def test_a_failed_pod_is_no_end_before_the_job_says_so(cluster: Any, machine: Machine) -> None:
    """It may try again, and a deploy right afterwards must find that it has failed."""
    standing = Standing({JOB: task()})
    live = {**task(), "status": {"active": 1}}
    live["metadata"] = {**live["metadata"], "uid": "j"}
    owner = {"uid": "j", "controller": True}
    pod = {"metadata": {"name": "p", "uid": "p", "ownerReferences": [owner]}, "spec": {}}
    pod["status"] = ended({"spec": {"containers": [{"name": "node"}]}}, 1)
    related = find_related([], [pod])
    standing.look({JOB: live}, related, 0.0)
    assert list(standing.find_causes()) == []
    live["status"] = {"conditions": [{"type": "Failed", "status": "True", "message": "limit"}]}
    standing.look({JOB: live}, related, 0.0)
    assert [cause.kind for _, cause in standing.find_causes()] == ["failed"]


def test_a_successor_that_is_refused_is_so_before_any_write(cluster: Any, machine: Machine) -> None:
    """The old one stays, with its log."""
    deploy(desired(task()), cluster, report=Recorder())
    before = cluster.objects[JOB]["metadata"]["uid"]
    refused = make_refusal("apply", 422, "Invalid", "no such field")

    def refuse(live: dict[str, Any], dry_run: bool) -> Refusal | None:  # noqa: FBT001
        image = live["kind"] == "Job" and live["spec"]["template"]["spec"]["containers"][0]["image"]
        return refused if image == "app:2" and live["metadata"]["name"] != "spawn" else None

    cluster.store.refuse = refuse
    with pytest.raises(Refused, match="nothing was changed"):
        deploy(desired(task("app:2")), cluster, report=Recorder())
    assert cluster.objects[JOB]["metadata"]["uid"] == before


def test_a_task_of_a_robot_that_is_away_is_not_waited_for() -> None:
    """It runs when the machine is back, as its other nodes do."""
    live = {**task(), "status": {"active": 1}}
    for machine, done in (("robot", True), ("other", False)):
        pod = {"metadata": {"name": "p"}, "spec": {"nodeName": machine}}
        assert readiness_without(live, [pod], [pod], {"robot"}).done is done
    assert not readiness_without(live, [], [], {"robot"}).done


def test_one_that_takes_too_long_has_a_way_out(cluster: Any, machine: Machine) -> None:
    machine.code = None
    with pytest.raises(RolloutFailed, match=r"1 of 1 not ready within 0\.1 s: spawn") as caught:
        deploy(desired(task()), cluster, report=Recorder(), timeout=0.1)
    assert caught.value.details == ("Job spawn: has not ended yet",)
    assert caught.value.hint is not None
    assert caught.value.hint.startswith("if it takes longer, set `timeout`")


def test_one_that_cannot_start_is_explained_as_others_are(cluster: Any, machine: Machine) -> None:
    waiting = {"waiting": {"reason": "InvalidImageName", "message": "bad"}}
    states = [{"name": "node", "image": "A", "ready": False, "state": waiting, "restartCount": 0}]
    cluster.store.controllers = Controllers(
        lambda _: {"phase": "Pending", "containerStatuses": states}
    )
    with pytest.raises(RolloutFailed, match="spawn did not succeed: invalid image name 'A'"):
        deploy(desired(task()), cluster, report=Recorder())


def test_a_restart_runs_it_again(cluster: Any, machine: Machine) -> None:
    report = Recorder()
    deploy(desired(task()), cluster, report=report)
    restart(cluster, RELEASE, [JOB], DeployOptions(report=report))
    assert len(machine.runs) == 2
    assert not diff(desired(task()), cluster).changes


def test_a_node_becomes_a_task_without_two_of_its_name(cluster: Any, machine: Machine) -> None:
    report = Recorder()
    deploy(desired(workload("spawn", singleton="/spawn")), cluster, report=report)
    pods: list[set[str]] = []
    cluster.store.before = lambda verb, ref: (
        pods.append(cluster.names("Pod")) if (verb, ref) == ("apply", JOB) else None
    )
    deploy(desired(task(singleton="/spawn")), cluster, report=report)
    assert pods == [set()]
    assert cluster.names("Deployment") == set()


def test_done_in_status_is_no_reason_to_look(cluster: Any, machine: Machine) -> None:
    deploy(desired(task()), cluster, report=Recorder())
    [found] = status(cluster, RELEASE).workloads
    assert (found.ok, found.ready, found.desired, found.message) == (True, 1, 1, "complete")
    [pod] = found.pods
    assert (pod.phase, pod.message) == ("Succeeded", "")
