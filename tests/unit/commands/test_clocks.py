"""Clocks of machines: which differences are reported, and how they are read in pods."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from rigel_inpod.sent import read_module
from rigel_k8s.commands import clocks, doctor
from rigel_k8s.commands import status as reading
from rigel_k8s.commands.clocks import TURNS, Clock, judge, judge_own, list_running
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, desired, workload
from tests.support.members import pod
from tests.support.pythons import find_python
from tests.support.recorder import Recorder
from tests.support.releases import deploy

REMEDY = "ages of messages and tf between them are wrong by that: run chrony or ntpd on both"

DAYS = 3 * 86400.0


def words(problems: Sequence[Problem]) -> list[str]:
    return [problem.message for problem in problems]


@pytest.mark.parametrize(
    ("ahead", "doubt", "text"),
    [
        (0.240, 0.002, "clocks: robot2 is 240 ms ahead of node1 (±3 ms)"),
        (-0.240, 0.002, "clocks: robot2 is 240 ms behind node1 (±3 ms)"),
        (-2.44, 0.0001, "clocks: robot2 is 2.4 s behind node1 (±1 ms)"),
        (7300.0, 0.002, "clocks: robot2 is 2 h ahead of node1 (±3 ms)"),
        (-1.7e9, 0.002, "clocks: robot2 is 19676 days behind node1 (±3 ms)"),
        (0.0132, 0.002, "clocks: robot2 is 13 ms ahead of node1 (±3 ms)"),
        (0.0129, 0.002, None),  # 10 ms, and the uncertainties of both
        (0.240, 0.230, None),
    ],
)
def test_a_difference_that_is_certain_is_reported(
    ahead: float, doubt: float, text: str | None
) -> None:
    found = judge({"robot2": Clock(5 + ahead, doubt), "node1": Clock(5.0, 0.001)})
    assert words(found) == ([text] if text else [])
    assert [(one.remedy, one.severity) for one in found] == [(REMEDY, "warning")] * len(found)


def test_a_machine_is_reported_once_against_one_that_most_agree_with() -> None:
    """Not each pair; the machine with the first name may be the wrong one."""
    right = {name: Clock(0.001, 0.001) for name in ("b", "c", "d")}
    found = judge({"a": Clock(1.501, 0.001), **right})
    assert words(found) == ["clocks: a is 1500 ms ahead of b (±2 ms)"]
    found = judge({**right, "a": Clock(1.5, 0.0), "e": Clock(-0.5, 0.0)})
    assert [one.subjects for one in found] == [("a", "b"), ("e", "b")]


def test_ends_of_a_row_differ_even_if_both_agree_with_the_middle() -> None:
    row = {name: Clock(ahead, 0.001) for name, ahead in (("b", 0.0), ("a", 0.008), ("c", 0.016))}
    assert words(judge(row)) == ["clocks: c is 16 ms ahead of b (±2 ms)"]
    assert judge({}) == judge({"a": Clock(9.0, 0.0)}) == []


def test_this_computer_is_compared_with_what_most_machines_agree_on() -> None:
    found = judge_own({name: Clock(0.3, 0.001) for name in "bc"} | {"a": Clock(0.0, 0.001)})
    assert words(found) == ["clocks: this computer is 300 ms behind b (±1 ms)"]
    assert judge_own({"a": Clock(0.0105, 0.001)}) == judge_own({}) == []


class Pods(FakeCluster):
    """A cluster whose pods have clocks.

    Attributes:
        ahead: seconds by the beginning of a pod's name; a pod without has no Python, one with NaN
            never answers.
        asked: the pods in which something was run.
    """

    ahead: dict[str, float]
    asked: list[str]
    end: threading.Event

    def exec(self, _: str, pod: str, __: Any, *, stdin: BinaryIO, stdout: Any, **___: Any) -> int:
        """Answer each line."""
        self.asked.append(pod)
        ahead = next((x for name, x in self.ahead.items() if pod.startswith(name)), None)
        if ahead is None:
            return 127
        if ahead != ahead:
            self.end.wait(600)
            raise ClusterError("the machine is away")
        while stdin.readline():
            stdout.write(b"%.6f\n" % (time.time() + ahead))
        return 0


@pytest.fixture
def cluster(fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch) -> Iterator[Pods]:
    """A release of two pods on two machines, which status and doctor find."""
    made = Pods(fake.store)
    made.ahead, made.asked = {"talker": 0.0, "listener": 0.0}, []
    made.end = threading.Event()
    deploy(desired(workload("talker"), workload("listener")), fake, report=report)
    move(made, "listener", "robot2")
    monkeypatch.setattr(reading, "release", lambda *_, **__: Release(made, RELEASE))  # type: ignore[arg-type]
    monkeypatch.setattr(doctor, "connect", lambda _: made)
    monkeypatch.setattr(doctor, "list_namespaces", lambda *_: ["n"])
    yield made
    made.end.set()


def move(cluster: Pods, name: str, machine: str) -> None:
    """Put a workload's pods on a machine, where they run."""
    for live in cluster.objects.values():
        if live["kind"] == "Pod" and live["metadata"]["name"].startswith(name):
            live["spec"]["nodeName"] = machine


def see() -> tuple[list[str], list[str]]:
    """Return what status and doctor report about clocks."""
    found = reading.status(Settings(), None)
    assert found.ok
    needs = [need for need in doctor.examine(Settings()) if need.what == "clocks"]
    (addition,) = found.additions
    return [one["message"] for one in addition.json["clocks"]], [need.state for need in needs]


def test_status_and_doctor_report_clocks_that_differ(cluster: Pods) -> None:
    """And nothing if they do not."""
    assert see() == ([], [])
    cluster.ahead["listener"] = DAYS
    (line,), (need,) = see()
    assert line.startswith("clocks: robot2 is 3 days ahead of node1 (±")
    assert need.startswith("robot2 is 3 days ahead of node1 (±")


def test_doctor_alone_reports_the_clock_of_this_computer(cluster: Pods) -> None:
    cluster.ahead = {"talker": DAYS, "listener": DAYS}
    lines, (need,) = see()
    assert lines == []
    assert need.startswith("this computer is 3 days behind node1 (±")


def test_nothing_is_run_for_a_release_on_one_machine(cluster: Pods) -> None:
    move(cluster, "listener", "node1")
    cluster.ahead = {"talker": DAYS, "listener": 0.0}
    assert see() == ([], [])
    assert cluster.asked == []


def test_no_graph_reads_no_clock(cluster: Pods) -> None:
    assert reading.status(Settings(), None, graph=False).additions == ()
    assert cluster.asked == []


def test_a_pod_without_python_is_passed_over(cluster: Pods) -> None:
    """The next one on its machine answers."""
    cluster.ahead = {"talker": DAYS, "listener": 0.0}
    talker = next(one for one in cluster.list("v1", "Pod", "n") if "talker" in str(one["metadata"]))
    meta = {key: talker["metadata"][key] for key in ("labels", "namespace")}
    bare = {**talker, "metadata": {**meta, "name": "bare-1"}}
    found = clocks.finish(clocks.begin(cluster, [bare, *cluster.list("v1", "Pod", "n")]), 30.0)  # type: ignore[arg-type]
    assert "bare-1" in cluster.asked
    assert found.keys() == {"node1", "robot2"}


def test_a_machine_that_does_not_answer_holds_no_other_up(cluster: Pods) -> None:
    cluster.ahead["listener"] = float("nan")
    begun = clocks.begin(cluster, cluster.list("v1", "Pod", "n"))  # type: ignore[arg-type]
    assert clocks.finish(begun).keys() <= {"node1"}
    assert begun.dials["robot2"].thread.is_alive()


def test_a_pod_of_a_lost_machine_is_not_asked(cluster: Pods) -> None:
    items = [pod("a"), pod("b")]
    items[1]["spec"]["nodeName"] = "node2"
    items[1]["status"]["conditions"] = [
        {"type": "Ready", "status": "False"},
        {"type": "ContainersReady", "status": "True"},
    ]
    assert clocks.begin(cluster, items).dials == {}  # type: ignore[arg-type]


class Slow(FakeCluster):
    """Pods 0.3 s ahead, whose questions take longer than their answers; it is the clock, too."""

    now = 50.0

    def time(self) -> float:
        return 1000 + self.now

    def monotonic(self) -> float:
        return self.now

    def exec(self, *_: Any, stdin: BinaryIO, stdout: Any, **__: Any) -> int:
        """Answer; the third one at once."""
        for seconds in (0.4, 0.1, 0.002, 0.1, 0.4, 0.4, 0.4, 0.4):
            stdin.readline()
            self.now += seconds
            answer = b"%.6f\n" % (self.time() + 0.3)
            stdout.write(answer[:5])
            stdout.write(answer[5:])
        return 0


def test_the_quickest_answer_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the time that it took is the uncertainty."""
    cluster: Any = Slow()
    monkeypatch.setattr(clocks, "time", cluster)
    dial = clocks.Dial(cluster, list_running([pod("a")]))
    dial.thread.join(60)
    assert dial.clock is not None
    assert dial.clock.ahead == pytest.approx(0.301)
    assert dial.clock.doubt == pytest.approx(0.001)


class Here:
    """A cluster whose pods are this machine, with a Python of its own."""

    def __init__(self, folder: Path) -> None:
        self.path = str(folder)

    def exec(
        self, _: str, __: str, command: list[str], *, stdin: BinaryIO, stdout: Any, **___: Any
    ) -> int:
        """Run a command with the clock of this machine."""
        env = {"PATH": self.path}
        with subprocess.Popen(command, stdin=stdin, stdout=subprocess.PIPE, env=env) as process:
            assert process.stdout is not None
            while line := process.stdout.readline():
                stdout.write(line)
        return process.wait()


@pytest.mark.programs
@pytest.mark.parametrize(("version", "name"), [("2.7", "python"), ("3", "python3")])
def test_pythons_of_all_images_print_the_time(version: str, name: str, tmp_path: Path) -> None:
    """A shell finds it; on the machine of the ruler both clocks are the same."""
    python = sys.executable if version == "3" else find_python(version)
    (tmp_path / name).symlink_to(python)
    items = [pod("a"), pod("b")]
    items[1]["spec"]["nodeName"] = "node2"
    found = clocks.finish(clocks.begin(Here(tmp_path), items), 60.0)  # type: ignore[arg-type]
    assert found.keys() == {"node1", "node2"}
    assert judge(found) == judge_own(found) == []


@pytest.mark.programs
def test_the_program_ends_although_its_input_does_not() -> None:
    """An old kubelet does not pass the end of the input on."""
    words = [sys.executable, "-c", read_module("rigel_inpod.sent.clock"), str(TURNS)]
    silent, held = os.pipe()
    os.write(held, b"\n" * (TURNS + 3))
    done = subprocess.run(words, stdin=silent, capture_output=True, timeout=60)
    assert len(done.stdout.splitlines()) == TURNS
    os.close(held)
    os.close(silent)
