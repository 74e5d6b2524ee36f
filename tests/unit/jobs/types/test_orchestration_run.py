"""The orchestration job as a whole: what comes before what, and what ends it."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s import kube
from rigel_k8s.app.deploying import places, results, secrets
from rigel_k8s.discovery import check as graph
from rigel_k8s.errors import ClusterError, RigelK8sError, RolloutFailed, UserError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.types.orchestration import OrchestrationJob
from rigel_k8s.network.multus import install as network_install
from rigel_k8s.network.preflight import examine as preflight
from rigel_k8s.network.preflight.interfaces import INTERFACE_MISSING, INTERFACE_NO_CARRIER
from rigel_k8s.network.preflight.presence import MULTUS_MISSING
from rigel_k8s.observability import install as observability_install
from rigel_k8s.release import deploy as deploys
from rigel_k8s.release import types
from rigel_k8s.release.types import ReleaseId, Revision
from rigel_k8s.rosgraph import watching
from rigel_k8s.settings import Application, Settings
from tests.support.controllers import Controllers, running, unready
from tests.support.fake_cluster import FakeCluster
from tests.support.options import options
from tests.support.recorder import Recorder

IMAGE = "lab/app@sha256:" + "ab" * 32
NODES = {"talker": {"args": ["talk"]}}
WHOLE = {
    "image": IMAGE,
    "nodes": NODES,
    "network": {"mode": "macvlan", "interface": "eth0", "subnet": "10.1.0.0/24", "install": True},
    "observability": {"enabled": True},
    "results": {"source_path": "/data", "target": "results"},
}
STEPS = [
    "places",
    "network installed",
    "network looked at",
    "stack",
    "pull secret",
    "deploy",
    "graph",
    "results",
]


@pytest.fixture
def run(
    fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., None]:
    """Run a job on the fake: run(raw, distro="noetic", timeout=1)."""
    monkeypatch.setattr(kube, "connect", lambda settings: fake)

    def call(raw: dict[str, Any], *, distro: str = "jazzy", **words: Any) -> None:
        where = Settings(namespace="n", **words)
        job = JobContext("deploy", Application(distro), report, where, raw=raw)
        OrchestrationJob().run(options(raw), job)

    return call


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], dict[str, RigelK8sError]]:
    """The steps that were taken, and what some of them are to fail with."""
    taken: list[str] = []
    fails: dict[str, RigelK8sError] = {}

    def step(name: str, result: Any = None) -> Callable[..., Any]:
        def call(*_: Any, **__: Any) -> Any:
            taken.append(name)
            if name in fails:
                raise fails[name]
            return result

        return call

    revision = Revision(ReleaseId("n", "demo"), 1, "good", "", (), ())
    monkeypatch.setattr(places, "check_places", step("places"))
    monkeypatch.setattr(network_install, "install", step("network installed"))
    monkeypatch.setattr(preflight, "check", step("network looked at"))
    monkeypatch.setattr(observability_install, "ensure", step("stack"))
    monkeypatch.setattr(secrets, "write_pull_secret", step("pull secret"))
    monkeypatch.setattr(deploys, "deploy", step("deploy", revision))
    monkeypatch.setattr(graph, "check", step("graph"))
    monkeypatch.setattr(results, "copy_results", step("results", "results/data"))
    return taken, fails


def test_a_deploy_goes_its_way(run: Any, steps: Any, report: Recorder) -> None:
    """What the cluster lacks is known before anything is written, and the graph when it runs."""
    run(WHOLE)
    assert steps[0] == STEPS
    assert report.lines[-1] == "results copied to results/data"


@pytest.mark.parametrize("failing", [s for s in STEPS if s not in ("stack", "results")])
def test_nothing_comes_after_a_step_that_failed(run: Any, steps: Any, failing: str) -> None:
    taken, fails = steps
    fails[failing] = UserError("no")
    with pytest.raises(UserError):
        run(WHOLE)
    assert taken == STEPS[: STEPS.index(failing) + 1]


def test_a_stack_that_is_not_ready_is_the_last_word(run: Any, steps: Any, report: Recorder) -> None:
    """The robots run all the same, and the job has failed."""
    taken, fails = steps
    fails["stack"] = RolloutFailed("loki is not ready")
    with pytest.raises(RolloutFailed, match="loki"):
        run(WHOLE)
    assert taken == STEPS
    assert report.warnings == ["loki is not ready; the application is deployed anyway"]


def test_ros_1_has_no_graph_to_look_at(run: Any, steps: Any) -> None:
    """A master knows its nodes."""
    run({"image": IMAGE, "nodes": NODES}, distro="noetic")
    assert steps[0] == ["places", "pull secret", "deploy"]


def test_results_that_are_not_there_do_not_fail_a_deploy(
    run: Any, steps: Any, report: Recorder
) -> None:
    """Unless they are waited for."""
    steps[1]["results"] = ClusterError("no results")
    run(WHOLE)
    assert "`results: {wait: 1m}`" in report.warnings[-1]
    with pytest.raises(ClusterError, match="no results"):
        run({**WHOLE, "results": {**WHOLE["results"], "wait": "1s"}})  # type: ignore[dict-item]


# With the fake.


def test_labels_that_no_machine_has_are_told_before_anything_is_written(
    run: Any, fake: FakeCluster
) -> None:
    fake.create({"apiVersion": "v1", "kind": "Node", "metadata": {"name": "node1", "labels": {}}})
    fake.calls.clear()
    placed = {"talker": {"args": ["talk"], "placement": {"node": "node2"}}}
    with pytest.raises(UserError, match="no machine of the cluster has the labels"):
        run({"image": IMAGE, "nodes": placed}, distro="noetic")
    assert fake.writes == []


def test_the_timeout_reaches_the_roll_out(
    run: Any, fake: FakeCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The flag's, the job's: whichever is said."""
    monkeypatch.setattr(types, "DEFAULT_TIMEOUT", 5)
    fake.store.controllers = Controllers(unready)
    raw = {"image": IMAGE, "nodes": NODES, "deploy_ros_master": False}
    with pytest.raises(RolloutFailed, match=r"not ready within 0\.2 s: talker"):
        run(raw, distro="noetic", timeout=0.2)
    with pytest.raises(RolloutFailed, match=r"not ready within 1 s: talker"):
        run({**raw, "timeout": "1s"}, distro="noetic")


def only_args(args: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return a kubelet that gets pods ready whose container has one argument."""

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        fits = args in json.dumps(pod["spec"]["containers"])
        return running(pod) if fits else unready(pod)

    return kubelet


def test_a_failed_roll_out_is_rolled_back_where_that_is_asked_for(
    run: Any, fake: FakeCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stays a failure, with its own cause first; what was good before runs again."""
    monkeypatch.setattr(watching.GraphWatch, "begin", lambda *_: None)  # no pod can be asked
    fake.store.controllers = Controllers(only_args("sleep 11"))
    raw = {"image": IMAGE, "deploy_ros_master": False}

    def deploy(argument: str, **words: Any) -> None:
        run({**raw, "nodes": {"talker": {"args": [argument]}}}, distro="noetic", **words)

    deploy("sleep 11")
    with pytest.raises(RolloutFailed) as caught:
        deploy("sleep 12", timeout=2, rollback_on_failure=True)  # the rollback has as long
    assert "not ready within 2 s: talker" in caught.value.message
    assert caught.value.message.endswith(": rolled back to revision 1, as revision 3")
    release = ReleaseId("n", "rigel-k8s-application")
    assert [r.status for r in deploys.history(fake, release)] == ["superseded", "failed", "good"]
    [live] = [o for ref, o in fake.objects.items() if ref.kind == "Deployment"]
    assert "sleep 11" in json.dumps(live["spec"])


def test_a_first_deploy_that_fails_has_nothing_to_go_back_to(run: Any, fake: FakeCluster) -> None:
    """It stays as it was applied, to be looked at."""
    fake.store.controllers = Controllers(unready)
    raw = {"image": IMAGE, "nodes": NODES, "deploy_ros_master": False}
    with pytest.raises(RolloutFailed, match=r"there is no earlier good revision to go back to"):
        run(raw, distro="noetic", timeout=0.2, rollback_on_failure=True)
    assert "talker" in fake.names("Deployment")


def test_a_cancelled_job_ends_its_deploy(
    fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kube, "connect", lambda settings: fake)
    cancel = threading.Event()
    cancel.set()
    raw = {"image": IMAGE, "nodes": NODES}
    where = Settings(namespace="n")
    job = JobContext("deploy", Application("noetic"), report, where, raw=raw, cancel=cancel)
    with pytest.raises(RigelK8sError, match="before anything was changed"):
        OrchestrationJob().run(options(raw), job)
    assert fake.names("Deployment", "ConfigMap") == set()


def test_adopt_reaches_the_deploy(run: Any, fake: FakeCluster) -> None:
    meta = {"name": "talker", "namespace": "n"}
    labels = {"app.kubernetes.io/name": "talker"}
    template = {"metadata": {"labels": labels}, "spec": {"containers": []}}
    spec = {"selector": {"matchLabels": labels}, "template": template}
    theirs = {"apiVersion": "apps/v1", "kind": "Deployment", "metadata": meta, "spec": spec}
    fake.as_manager("kubectl").create(theirs)
    raw = {"image": IMAGE, "nodes": NODES, "deploy_ros_master": False}
    with pytest.raises(RigelK8sError, match="managed by others"):
        run(raw, distro="noetic")
    run(raw, distro="noetic", adopt=True)


def test_errors_of_the_preflight_end_the_deploy(report: Recorder) -> None:
    """Warnings are told; all errors are in one."""
    beware = INTERFACE_NO_CARRIER.problem("eth0 has no link", "mind it")
    preflight.report_findings([beware], report)
    assert report.warnings == ["eth0 has no link; mind it [interface-no-carrier]"]
    lacks = MULTUS_MISSING.problem("there is no Multus", "install it")
    with pytest.raises(ClusterError, match=r"there is no Multus \[multus-missing\]"):
        preflight.report_findings([beware, lacks], report)
    wrong = INTERFACE_MISSING.problem("no eth7", "name another")
    with pytest.raises(UserError, match="2 things keep the network") as caught:
        preflight.report_findings([lacks, wrong], report)
    assert "no eth7 [interface-missing]" in caught.value.details
