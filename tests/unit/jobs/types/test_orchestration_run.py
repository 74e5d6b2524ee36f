"""The orchestration job as a whole: what comes before what, and what ends it."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from rigel_graph import watching
from rigel_graph.discovery import check as graph
from rigel_k8s import kube
from rigel_k8s.errors import ClusterError, RigelK8sError, RolloutFailed
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.types.orchestration import OrchestrationJob
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import revisions, types
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Application, Settings
from tests.support.clock import leap_when_shown
from tests.support.controllers import Controllers, running, unready
from tests.support.fake_cluster import FakeCluster
from tests.support.options import options
from tests.support.recorder import Recorder

IMAGE = "lab/app@sha256:" + "ab" * 32
NODES = {"talker": {"args": ["talk"]}}
WHOLE = {
    "image": IMAGE,
    "nodes": NODES,
    "deploy_ros_master": False,
    "observability": {"enabled": True},
}


@pytest.fixture
def run(
    fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., None]:
    """Run a job on the fake: run(raw, distro="noetic", timeout=1)."""
    monkeypatch.setattr(kube, "connect", lambda settings: fake)
    monkeypatch.setattr(watching.GraphWatch, "report_misfits", lambda _: None)  # no pod answers

    def call(raw: dict[str, Any], *, distro: str = "jazzy", data: Any = None, **words: Any) -> None:
        where = Settings(**{"namespace": "n", **words})
        job = JobContext("deploy", Application(distro), report, where, data or {}, raw=raw)
        OrchestrationJob().run(options(raw), job)

    return call


def test_a_deploy_goes_its_way(run: Any, fake: FakeCluster, report: Recorder) -> None:
    """The application is written and ready before the stack is begun; its graph comes after."""
    run(WHOLE, distro="noetic")
    applied = [ref.name for verb, ref in fake.writes if isinstance(ref, ObjectRef)]
    assert applied.index("talker") < applied.index("loki")
    lines = report.lines
    done = [line.split()[0] for line in lines if "is at revision" in line]
    assert done == ["rigel-k8s-application", "rigel-observability"]


def test_robots_do_not_wait_for_dashboards(
    run: Any, fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stack that does not become ready is a warning; the job is done."""

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        return unready(pod) if pod["metadata"]["namespace"] == "monitoring" else running(pod)

    fake.store.controllers = Controllers(kubelet)
    leap_when_shown(monkeypatch, report, 61, ("loki", "0 of 1 ready"))
    run(WHOLE, distro="noetic", timeout=60)
    assert any("loki" in text and "everything else" in text for text in report.warnings)
    assert "talker" in fake.names("Deployment")


@pytest.mark.parametrize(("distro", "looks"), [("noetic", 0), ("jazzy", 1)])
def test_ros_1_has_no_graph_to_look_at(
    run: Any, monkeypatch: pytest.MonkeyPatch, distro: str, looks: int
) -> None:
    """A master knows its nodes."""
    asked: list[str] = []
    monkeypatch.setattr(graph, "check", lambda *_: asked.append("graph"))
    run({"image": IMAGE, "nodes": NODES, "deploy_ros_master": False}, distro=distro)
    assert len(asked) == looks


def test_results_that_are_not_there_do_not_fail_a_deploy(
    run: Any, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless they are waited for."""

    def copy(*_: Any) -> None:
        raise ClusterError("no results")

    monkeypatch.setattr("rigel_k8s.app.deploying.part.copy_results", copy)
    results = {"source_path": "/data", "target": "results"}
    raw = {"image": IMAGE, "nodes": NODES, "deploy_ros_master": False}
    run({**raw, "results": results}, distro="noetic")
    assert "`results: {wait: 1m}`" in report.warnings[-1]
    with pytest.raises(ClusterError, match="no results"):
        run({**raw, "results": {**results, "wait": "1s"}}, distro="noetic")


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
    run: Any, fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stays a failure, with its own cause first; what was good before runs again."""
    monkeypatch.setattr(watching.GraphWatch, "begin", lambda *_: None)  # no pod can be asked
    fake.store.controllers = Controllers(only_args("sleep 11"))
    raw = {"image": IMAGE, "deploy_ros_master": False}

    def deploy(argument: str, **words: Any) -> None:
        run({**raw, "nodes": {"talker": {"args": [argument]}}}, distro="noetic", **words)

    deploy("sleep 11")
    report.states.clear()
    leap_when_shown(monkeypatch, report, 61, ("talker", "0 of 1"))  # once: the rollback has time
    with pytest.raises(RolloutFailed) as caught:
        deploy("sleep 12", timeout=60, rollback_on_failure=True)
    assert "not ready within 60 s: talker" in caught.value.message
    assert caught.value.message.endswith(": rolled back to revision 1, as revision 3")
    release = ReleaseId("n", "rigel-k8s-application")
    assert [r.status for r in revisions.history(fake, release)] == ["superseded", "failed", "good"]
    [live] = [o for ref, o in fake.objects.items() if ref.kind == "Deployment"]
    assert "sleep 11" in json.dumps(live["spec"])


def test_the_commands_of_a_robots_hint_work_as_they_are_printed(
    run: Any, fake: FakeCluster
) -> None:
    """The Rigelfile of a fleet alone does not have the namespace of one robot."""
    raw = {"image": IMAGE, "nodes": NODES, "deploy_ros_master": False}
    fake.store.controllers = Controllers(unready)
    hints = []
    for words in ({"data": {"robot": "n"}, "namespace": None}, {"namespace": None}, {}):
        with pytest.raises(RolloutFailed) as caught:
            run({**raw, "namespace": "n"}, distro="noetic", timeout=0.2, **words)
        hints.append(caught.value.hint)
    of_robot = (
        "`rigel logs talker --release rigel-k8s-application -n n` shows its output;"
        " `rigel status rigel-k8s-application -n n` shows its state"
    )
    alone = "`rigel logs talker` shows its output; `rigel status` shows its state"
    assert hints == [of_robot, alone, of_robot]


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
