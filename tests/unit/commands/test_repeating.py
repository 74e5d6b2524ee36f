"""`rigel test --repeat`: several runs on a simulated cluster, and what is counted of them."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from rigel_k8s.cli.main import cli
from rigel_k8s.commands.targets import Release
from rigel_k8s.commands.testing import repeating
from rigel_k8s.commands.testing.release import ReleaseTests
from rigel_k8s.commands.testing.repeating import draw_namespaces, repeat_tests, sum_up
from rigel_k8s.commands.testing.results import Result
from rigel_k8s.commands.testing.run import Trial
from rigel_k8s.errors import Interrupted, JobFailed, UserError
from rigel_k8s.jobs.runner import Prepared
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.network.plan import network_plan
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder

HEAD = "application: {distro: jazzy}\n"
NODES = "nodes: {talker: {args: [talk]}, hears: {kind: test, args: [hear]}}"
ROBOT = "plugin: rigel_k8s.OrchestrationPlugin, with: {image: r:1, %s}"
TEXT = HEAD + f"jobs: {{robot: {{{ROBOT % f'network: peers, {NODES}'}}}}}\n"
PLACE = "rigel_k8s.commands.testing.run"

#: What happens in the run of a number; returns the result of its one test.
Story = Callable[[int, threading.Event], Result]


def write(folder: Path, text: str = TEXT, **more: Any) -> Trial:
    """Write a Rigelfile; return what is tested of it."""
    (folder / "Rigelfile").write_text(text)
    settings = Settings(folder / "Rigelfile", kubeconfig=folder / "kubeconfig", **more)
    return Trial(None, "robot", settings, 1.0, folder / "out")


@pytest.fixture
def tell(monkeypatch: pytest.MonkeyPatch) -> Callable[[Story], FakeCluster]:
    """Let runs deploy nothing into a simulated cluster, and tests end as a story has it."""
    cluster = FakeCluster()
    namespaces: list[str] = []

    def play(story: Story) -> FakeCluster:
        def run(tests: ReleaseTests) -> None:
            result = story(int(tests.folder.name), tests.cancel)
            tests.results[result.name] = result

        monkeypatch.setattr(ReleaseTests, "run", run)
        return cluster

    def run_job(prepared: Prepared, *_: Any, **__: Any) -> dict[str, Any]:
        namespaces.append(str(prepared.settings.namespace))
        return {}

    def list_found(_: FakeCluster, namespace: str) -> list[Release]:
        return [Release(cluster, ReleaseId(namespace, "app"))]  # type: ignore[arg-type]

    monkeypatch.setattr(f"{PLACE}.require_kubeconfig", lambda _: None)
    monkeypatch.setattr(f"{PLACE}.connect", lambda _: cluster)
    monkeypatch.setattr(f"{PLACE}.list_found", list_found)
    monkeypatch.setattr(f"{PLACE}.runner.run", run_job)
    return play


def list_namespaces(cluster: FakeCluster) -> list[str]:
    """Return the namespaces that are not being deleted."""
    found = cluster.list("v1", "Namespace")
    return [o["metadata"]["name"] for o in found if "deletionTimestamp" not in o["metadata"]]


def test_a_failure_ends_no_other_run(tell: Callable[[Story], FakeCluster], tmp_path: Path) -> None:
    """Each has a folder, a suite, a namespace that is deleted, and lines with its number."""

    def story(number: int, _: threading.Event) -> Result:
        state = "failed" if number in (2, 3) else "passed"
        return Result("app", "hears", state, float(number), f"heard {number}" * (state == "failed"))

    cluster, report, trial = tell(story), Recorder(), write(tmp_path)
    found, error = repeat_tests(trial, trial.prepare(), report, times=5, width=2)
    assert error is None
    assert found == [("3 of 5", Result("app", "hears", "failed", 5.0, "run 2: heard 2"))]
    root = ElementTree.parse(tmp_path / "out" / "rigel.xml").getroot()
    assert [one.attrib["name"] for one in root] == [f"app {number}" for number in range(1, 6)]
    assert [one.attrib["failures"] for one in root] == ["0", "1", "1", "0", "0"]
    assert all((tmp_path / "out" / str(number) / "rigel.xml").exists() for number in range(1, 6))
    begun = [path for path, _, text in report.entries if text.startswith("testing robot")]
    assert sorted(begun) == ["/1", "/2", "/3", "/4", "/5"]
    assert report.lines[-1].startswith("3 of 5 runs have passed")
    made = [ref.name for verb, ref in cluster.writes if verb == "create"]
    assert len(set(made)) == 5
    assert list_namespaces(cluster) == []


def test_runs_are_at_the_same_time(tell: Callable[[Story], FakeCluster], tmp_path: Path) -> None:
    """Each of three waits here for the two others."""
    meeting = threading.Barrier(3, timeout=30)

    def story(*_: Any) -> Result:
        meeting.wait()
        return Result("app", "hears", "passed")

    tell(story)
    trial = write(tmp_path)
    found, _ = repeat_tests(trial, trial.prepare(), Recorder(), times=3, width=3)
    assert [count for count, _ in found] == ["3 of 3"]


def test_a_run_that_fails_before_its_tests_is_counted(
    tell: Callable[[Story], FakeCluster], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a row of its own, with its cause; a failed deploy stops what is in it, and no more."""
    number = iter(range(1, 4))

    def deploy(*_: Any, scope: CancelScope) -> None:
        if next(number) == 1:
            scope.cancel()  # as the first failure of a run does
            raise JobFailed("job robot: talker crashed", details=["its log"])

    tell(lambda *_: Result("app", "hears", "passed"))
    monkeypatch.setattr(f"{PLACE}.runner.run", deploy)
    trial, report = write(tmp_path), Recorder()
    found, error = repeat_tests(trial, trial.prepare(), report, times=3, width=1)
    assert error is None
    assert [(one.name, count, one.message) for count, one in found] == [
        ("run", "2 of 3", "run 1: job robot: talker crashed"),
        ("hears", "2 of 2", ""),
    ]
    assert report.warnings == ["this run has failed: job robot: talker crashed\nits log"]


def test_what_is_wrong_with_the_first_run_ends_all(
    tell: Callable[[Story], FakeCluster], tmp_path: Path
) -> None:
    """A deploy that is refused because of what the user wrote is refused in each run."""

    def story(*_: Any) -> Result:
        refused = JobFailed("job robot: the image r:1 does not exist")
        refused.exit_code = 2
        raise refused

    cluster, trial = tell(story), write(tmp_path)
    found, error = repeat_tests(trial, trial.prepare(), Recorder(), times=20, width=1)
    assert isinstance(error, JobFailed)
    assert [count for count, _ in found] == ["0 of 1"]
    assert list_namespaces(cluster) == []


def test_ctrl_c_ends_all_runs_and_keeps_what_has_ended(
    tell: Callable[[Story], FakeCluster], tmp_path: Path
) -> None:
    """What they have deployed is deleted, no further run begins, and the user sees why it takes."""
    waiting = threading.Barrier(2, timeout=30)

    def story(number: int, cancel: threading.Event) -> Result:
        if number == 1:
            return Result("app", "hears", "passed")
        if waiting.wait() == 0:
            os.kill(os.getpid(), signal.SIGINT)
        assert cancel.wait(30)
        raise Interrupted("interrupted while the test hears ran")

    cluster, trial, report = tell(story), write(tmp_path), Recorder()
    found, error = repeat_tests(trial, trial.prepare(), report, times=9, width=2)
    assert isinstance(error, Interrupted)
    assert error.message == "interrupted: 3 of 9 runs had begun"
    assert [(one.name, count) for count, one in found] == [("hears", "1 of 1"), ("run", "1 of 3")]
    assert report.warnings == ["stopping, and deleting what is tested; Ctrl-C again ends at once"]
    assert list_namespaces(cluster) == []
    assert (tmp_path / "out" / "rigel.xml").exists()


@pytest.mark.parametrize("more", [{"keep": True}, {"width": 2}])
def test_a_namespace_of_the_users_own_is_for_one_run_after_the_other(
    more: dict[str, Any], tell: Callable[[Story], FakeCluster], tmp_path: Path
) -> None:
    cluster = tell(lambda *_: Result("app", "hears", "passed"))
    trial = write(tmp_path, namespace="lab")
    width = more.get("width", 1)
    refused = Trial(None, "robot", trial.settings, 1.0, trial.output, more.get("keep", False))
    with pytest.raises(UserError, match="with -n all runs use one namespace") as error:
        repeat_tests(refused, refused.prepare(), Recorder(), times=2, width=width)
    assert "leave out -n" in str(error.value.hint)
    assert cluster.writes == []


@pytest.mark.parametrize("width", [1, 2])
def test_what_runs_share_is_refused_only_at_the_same_time(
    width: int, tell: Callable[[Story], FakeCluster], tmp_path: Path
) -> None:
    """With the lines of the Rigelfile, and what to do."""
    cluster = tell(lambda *_: Result("app", "hears", "passed"))
    text = HEAD + (
        f"jobs:\n  robot: {{{ROBOT % f'network: host, {NODES}'}}}\n"
        "  file: {plugin: rigel_k8s.DockerfilePlugin, with: {ros_image: r:1}}\n"
        "sequences: {all: {stages: [{jobs: [file, robot]}]}}\n"
    )
    trial = write(tmp_path, text)
    whole = Trial("sequence", "all", trial.settings, 1.0, trial.output)
    prepared = whole.prepare()
    if width == 1:
        assert repeat_tests(whole, prepared, Recorder(), times=2, width=1)[1] is None
        return
    with pytest.raises(UserError, match="would disturb each other") as error:
        repeat_tests(whole, prepared, Recorder(), times=2, width=width)
    job, network = error.value.details
    assert job.startswith("the job file of each run would work on ")
    assert "Rigelfile:3:" in network
    assert "would meet on the machines' network [conflict]" in network
    assert cluster.writes == []


def test_no_two_runs_are_in_one_domain(
    tell: Callable[[Story], FakeCluster], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A domain is a hash of the namespace, and thirty of a hundred would not all differ."""
    tell(lambda *_: Result("app", "hears", "passed"))
    trial = write(tmp_path)
    prepared = trial.prepare()
    job = prepared.values.preview(prepared.steps.steps[0], {}).options  # type: ignore[arg-type]
    drawn = draw_namespaces(trial, prepared, 30)
    plans = [
        network_plan(
            job.network,
            namespace=namespace,
            release=str(job.deployment_name),
            ros=repeating.generation_of("jazzy", None),
            distro="jazzy",
        )
        for namespace in drawn
    ]
    assert len({plan.domain_id for plan in plans}) == 30
    assert len(draw_namespaces(trial, prepared, 300)) == 300  # more than there are domains


def test_a_test_that_was_not_measured_once_is_unknown() -> None:
    """It has not failed, and one that has failed once has."""
    rows = sum_up(
        {
            1: [Result("a", "/map: rate", "unknown"), Result("a", "hears", "failed", 1.0, "no")],
            2: [Result("a", "/map: rate", "passed"), Result("a", "hears", "passed", 0.5)],
        }
    )
    assert rows == [
        ("1 of 2", Result("a", "/map: rate", "unknown")),
        ("1 of 2", Result("a", "hears", "failed", 1.0, "run 1: no")),
    ]


def test_the_command_prints_each_test_once(
    tell: Callable[[Story], FakeCluster], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its exit code is 1 if one run has failed; --parallel alone has no effect, and is refused."""

    def no_deploy(*_: Any) -> Result:
        raise UserError("there is no namespace lab")

    monkeypatch.chdir(tmp_path)
    tell(
        lambda number, _: Result(
            "app", "hears", "failed" if number == 2 else "passed", 1.5, "deaf" * (number == 2)
        )
    )
    write(tmp_path)
    words = ["test", "robot", "--repeat", "2"]
    done = CliRunner().invoke(cli, words, standalone_mode=False, obj={})
    assert done.return_value == 1
    assert "TEST   PASSED  SLOWEST  CAUSE\nhears  1 of 2  1.5s     run 2: deaf\n" in done.output
    tell(no_deploy)
    done = CliRunner().invoke(cli, words, standalone_mode=False, obj={})
    assert isinstance(done.exception, UserError)
    assert "CAUSE" not in done.output  # the error has it
    words = ["test", "robot", "--parallel", "2"]
    done = CliRunner().invoke(cli, words, standalone_mode=False, obj={})
    assert "add --repeat N" in str(done.exception)
