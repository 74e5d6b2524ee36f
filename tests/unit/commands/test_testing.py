"""What `rigel test` makes of a pod, a namespace and results, on a simulated cluster."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from rigel_exporter.expecting import Expected, Finding
from rigel_graph.commands import expect
from rigel_graph.commands.expect import Examined
from rigel_graph.expectations import Verdict
from rigel_k8s.commands.targets import Release
from rigel_k8s.commands.testing.release import ReleaseTests
from rigel_k8s.commands.testing.results import Result, remove_results, write_results
from rigel_k8s.commands.testing.run import Trial, place_for
from rigel_k8s.errors import Interrupted, UserError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder

POD = ObjectRef("v1", "Pod", "n", "hears")
NAMESPACE = ObjectRef("v1", "Namespace", "", "n")
ENDED: Mapping[str, Any] = {"terminated": {"exitCode": 0, "reason": "Completed"}}


def make_pod(state: Mapping[str, Any], **status: Any) -> dict[str, Any]:
    """Return a test's pod whose container is in a state."""
    own = {"name": "ros-node", "image": "robot:1", "ready": False, "state": state}
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {"name": "hears", "namespace": "n", "uid": "1"},
        "spec": {"containers": [{"name": "ros-node"}]},
        "status": {"containerStatuses": [own], **status},
    }


class Cluster(FakeCluster):
    """One whose pods are as the test describes them: the next one with each look."""

    def show(self, *pods: dict[str, Any]) -> None:
        self.shown = list(pods)

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        if ref != POD:
            return super().get(ref)
        return self.shown.pop(0) if len(self.shown) > 1 else self.shown[0]


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Cluster:
    monkeypatch.setattr("rigel_k8s.commands.testing.release.LOOK", 0.0)
    return Cluster()


def watch(cluster: Cluster, within: float = 60.0, *, cancelled: bool = False) -> str:
    """Return why the test has not passed."""
    cancel = threading.Event()
    if cancelled:
        cancel.set()
    found = Release(cluster, ReleaseId("n", "robot"))  # type: ignore[arg-type]
    return ReleaseTests(found, Recorder(), within, Path(), cancel).wait(POD, "ros-node")


def test_a_test_that_ends_well_has_passed(cluster: Cluster) -> None:
    """Also if the container beside it still runs, as it does."""
    cluster.show(make_pod({"waiting": {"reason": "ContainerCreating"}}), make_pod(ENDED))
    assert watch(cluster) == ""


def test_one_that_fails_shows_its_own_words(cluster: Cluster) -> None:
    """The exit code, and the error at the end of what it has printed."""
    words = "collected 3 items\nAssertionError: heard nothing\n"
    cluster.show(make_pod({"terminated": {"exitCode": 1, "reason": "Error", "message": words}}))
    assert "exited with code 1 (AssertionError: heard nothing)" in watch(cluster)


def test_one_that_cannot_begin_is_given_up_early(cluster: Cluster) -> None:
    """A name that no image can have is hopeless at once; `within` would be minutes."""
    wrong = {"waiting": {"reason": "InvalidImageName", "message": "invalid reference format"}}
    cluster.show(make_pod(wrong))
    assert "invalid image name" in watch(cluster)


def test_one_that_does_not_end_has_failed(cluster: Cluster) -> None:
    cluster.show(make_pod({"running": {}}))
    assert watch(cluster, 0.01) == "it has not ended within 0.01 s"


def test_an_interruption_ends_the_wait(cluster: Cluster) -> None:
    cluster.show(make_pod({"running": {}}))
    with pytest.raises(Interrupted, match="while the test hears ran"):
        watch(cluster, cancelled=True)


def test_topics_count_before_and_after_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that a test has broken has failed; what was not measured has not."""
    states = iter(
        [
            {"/scan": ("ok", "10/s"), "/odom": ("ok", "9/s"), "/map": ("unknown", "not measured")},
            {"/scan": ("broken", "4/s"), "/odom": ("ok", "9/s"), "/map": ("ok", "1/s")},
        ]
    )

    def compare(*_: Any) -> Examined:
        verdicts = (
            Verdict(topic, Finding("rate", state, "8..12/s", measured))
            for topic, (state, measured) in next(states).items()
        )
        return Examined(ReleaseId("n", "robot"), tuple(verdicts))

    monkeypatch.setattr(expect, "read_expected", lambda _: {"/scan": Expected(rate=(8.0, 12.0))})
    monkeypatch.setattr(expect, "compare", compare)
    monkeypatch.setattr(ReleaseTests, "list_tests", lambda _: [{}])
    monkeypatch.setattr(ReleaseTests, "run_test", lambda *_: Result("robot", "hears", "passed"))
    found = Release(FakeCluster(), ReleaseId("n", "robot"))  # type: ignore[arg-type]
    made = ReleaseTests(found, Recorder(), 1.0, Path(), threading.Event())
    made.run()
    assert [(one.name, one.state, one.message) for one in made.results.values()] == [
        ("/scan: rate", "failed", "/scan: rate 4/s, expected 8..12/s"),
        ("/odom: rate", "passed", ""),
        ("/map: rate", "unknown", ""),
        ("hears", "passed", ""),
    ]


def test_a_namespace_that_was_made_goes_whatever_happens() -> None:
    """One that existed stays; `keep` leaves both."""
    for own, keep, stays in ((True, False, False), (True, True, True), (False, False, True)):
        cluster, report = FakeCluster(), Recorder()
        if not own:
            cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
        place = place_for(cluster, "n", report, own=own, keep=keep)  # type: ignore[arg-type]
        place.__enter__()
        assert cluster.get(NAMESPACE) is not None
        error = RuntimeError("what is tested has failed")
        assert not place.__exit__(RuntimeError, error, None)
        assert (("delete", NAMESPACE) not in cluster.writes) == stays


def test_what_has_ended_before_an_interruption_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its result is written, and shown by CI systems."""

    def run_test(_: ReleaseTests, deployment: dict[str, str]) -> Result:
        if deployment["name"] == "second":
            raise Interrupted("interrupted")
        return Result("robot", deployment["name"], "failed")

    monkeypatch.setattr(expect, "read_expected", lambda _: {})
    tests = [{"name": "first"}, {"name": "second"}]
    monkeypatch.setattr(ReleaseTests, "list_tests", lambda _: tests)
    monkeypatch.setattr(ReleaseTests, "run_test", run_test)
    found = Release(FakeCluster(), ReleaseId("n", "robot"))  # type: ignore[arg-type]
    made = ReleaseTests(found, Recorder(), 1.0, Path(), threading.Event())
    with pytest.raises(Interrupted):
        made.run()
    assert list(made.results) == ["first"]


def test_a_namespace_that_does_not_exist_leads_to_one_that_is_made() -> None:
    place = place_for(FakeCluster(), "nowhere", Recorder(), own=False, keep=False)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="there is no namespace nowhere") as error:
        place.__enter__()
    assert error.value.hint == "leave -n out: a namespace is made, and deleted in the end"


def test_a_file_without_tests_is_refused_before_anything_happens(tmp_path: Path) -> None:
    (tmp_path / "Rigelfile").write_text(
        "application: {distro: jazzy}\njobs: {a: {plugin: rigel_k8s.OrchestrationPlugin, with:"
        " {image: r:1, network: peers, nodes: {b: {args: [b]}}}}}\n"
    )
    settings = Settings(tmp_path / "Rigelfile", kubeconfig=tmp_path / "none")
    with pytest.raises(UserError, match="a has nothing to test: no node of `kind: test`"):
        Trial(None, "a", settings, 1.0, tmp_path / "out").prepare()


def test_results_are_junit(tmp_path: Path) -> None:
    """What cannot be in XML, such as a terminal's colors, is replaced."""
    results = [
        Result("robot", "hears", "failed", 1.5, "exited with code 1", "\x1b[31mnothing\x1b[0m"),
        Result("robot", "/scan: rate", "unknown"),
        Result("arm", "moves", "passed", 0.25),
    ]
    write_results(results, tmp_path / "new")
    root = ElementTree.parse(tmp_path / "new" / "rigel.xml").getroot()
    robot, arm = root.findall("testsuite")
    assert robot.attrib == {"name": "robot", "tests": "2", "failures": "1", "skipped": "1"}
    assert arm.attrib["failures"] == "0"
    failed, unknown = robot.findall("testcase")
    assert failed.attrib == {"classname": "robot", "name": "hears", "time": "1.500"}
    assert failed.find("failure") is not None
    assert failed.findtext("system-out") == "?[31mnothing?[0m"
    assert unknown.find("skipped") is not None
    assert [child.tag for child in arm.find("testcase") or ()] == []


def test_a_run_removes_what_the_one_before_has_left(tmp_path: Path) -> None:
    """And nothing that is someone else's, also in a folder that someone has named."""
    for name in ("logs", "bags", "arm-moves", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
    remove_results(tmp_path)  # no run has been here
    assert (tmp_path / "logs" / "file").exists()
    results = [Result("a", "/arm/moves", "passed"), Result("a", "/scan: rate", "passed")]
    write_results([*results, Result("a", "..", "failed")], tmp_path)
    remove_results(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["other"]
    for number in ("1", "2"):  # those of two runs
        write_results([Result("a", "moves", "passed")], tmp_path / number)
        (tmp_path / number / "moves").mkdir()
    (tmp_path / "2" / "mine").touch()
    write_results([Result("a 1", "moves", "passed"), Result("a 2", "moves", "passed")], tmp_path)
    remove_results(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["2", "other"]
    assert [path.name for path in (tmp_path / "2").iterdir()] == ["mine"]
    shutil.rmtree(tmp_path / "2")
    (tmp_path / "rigel.xml").write_text("no XML")
    remove_results(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["other"]
