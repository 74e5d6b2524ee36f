"""Providers around a run, and Ctrl-C and SIGTERM in a real process."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import attrs
import pytest

from rigel_k8s.errors import JobFailed, RigelK8sError, UserError
from rigel_k8s.jobs import engine
from rigel_k8s.jobs.engine import Declared
from rigel_k8s.jobs.job import JobContext, JobReporter
from rigel_k8s.jobs.steps import Jobs
from rigel_k8s.settings import Application
from tests.support.recorder import Recorder
from tests.support.until import until

from .conftest import Around, make_branches, make_job, run_steps


@attrs.define
class NotingProvider:
    """Notes what happens to it; `refuses` is what connect raises."""

    events: list[str]
    refuses: Exception | None = None
    sulks: bool = False
    options = dict

    def check(self, options: Any, application: Application) -> tuple[()]:
        return ()

    def connect(self, options: Any, name: str, report: JobReporter) -> str:
        self.events.append(f"connect {name}")
        if self.refuses:
            raise self.refuses
        return f"connection of {name}"

    def disconnect(self, connection: Any) -> None:
        self.events.append(f"disconnect {connection}")
        if self.sulks:
            raise RuntimeError("busy")


def declare(name: str, provider: NotingProvider) -> Declared:
    return Declared(name, provider, {})


def test_providers_are_connected_before_and_disconnected_after(around: Around) -> None:
    """Jobs get the connections by name; the last connected is the first disconnected."""
    events: list[str] = []

    def work(job: JobContext) -> None:
        events.append(f"job with {job.providers['two']}")

    provider = NotingProvider(events)
    run_steps(Jobs((make_job("j", work),)), around, [declare(n, provider) for n in ("one", "two")])
    assert events == [
        "connect one",
        "connect two",
        "job with connection of two",
        "disconnect connection of two",
        "disconnect connection of one",
    ]


def test_a_provider_that_refuses_is_named_and_the_connected_are_let_go(
    around: Around,
) -> None:
    """No job runs; the error keeps whose fault it is."""
    events: list[str] = []
    good = declare("good", NotingProvider(events))
    bad = declare("bad", NotingProvider(events, UserError("wrong password", hint="log in")))
    job = make_job("j", lambda job: events.append("ran"))
    with pytest.raises(UserError, match="provider bad could not connect: wrong password"):
        run_steps(Jobs((job,)), around, [good, bad])
    assert events == ["connect good", "connect bad", "disconnect connection of good"]


def test_a_provider_that_does_not_disconnect_is_told(around: Around, told: Recorder) -> None:
    """What was done stays done; the rest is disconnected all the same."""
    events: list[str] = []
    sulky = declare("sulky", NotingProvider(events, sulks=True))
    run_steps(
        Jobs((make_job("j", lambda job: None),)),
        around,
        [declare("good", NotingProvider(events)), sulky],
    )
    assert told.of("warn") == ["provider sulky did not disconnect: busy"]
    assert events[-1] == "disconnect connection of good"


def test_a_job_that_ignores_cancel_is_left_and_told(around: Around, told: Recorder) -> None:
    """After a failure the others are waited for, for the grace and no longer."""
    release, meet = threading.Event(), threading.Barrier(2)

    def work(job: JobContext) -> None:
        meet.wait(20)
        if job.data["robot"] == 1:
            raise RigelK8sError("no")
        release.wait(20)

    steps = Jobs((make_branches({"robot": [1, 2]}, Jobs((make_job("deaf", work),))),))
    with pytest.raises(JobFailed):
        run_steps(steps, attrs.evolve(around, grace=0.05))
    assert told.of("warn") == ["job deaf (robot=2) did not stop within 0.05 s and was abandoned"]
    release.set()


ROOT = Path(__file__).parents[3]
Start: TypeAlias = Callable[..., "subprocess.Popen[str]"]

PROGRAM = """
import sys, threading
from rigel_k8s.errors import Interrupted
from rigel_k8s.jobs.engine import Declared
from rigel_k8s.jobs.steps import Jobs
from tests.unit.jobs.conftest import Around, make_job, run_steps

def say(text):
    print(text, flush=True)

class Report:
    def line(self, text): say(text)
    def warn(self, text): say("warn " + text)
    def progress(self, key, state, *, done=False): pass
    def child(self, name): return self

class Provider:
    options = dict
    def check(self, options, application): return ()
    def connect(self, options, name, report): return name
    def disconnect(self, connection): say("disconnected " + connection)

def listens(job):
    say("running")
    job.cancel.wait()
    say("cleaned up")

def deaf(job):
    say("running")
    threading.Event().wait()

around = Around(Report(), grace=float(sys.argv[2]))
job = make_job("work", {"listens": listens, "deaf": deaf}[sys.argv[1]])
try:
    run_steps(Jobs((job,)), around, [Declared("robot", Provider(), {})])
except Interrupted as error:
    say(f"{error.message} {error.details}")
    sys.exit(error.exit_code)
"""


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start the program, and return once its job runs; what a failed test leaves is ended."""
    started: list[subprocess.Popen[str]] = []

    def call(*words: str) -> subprocess.Popen[str]:
        program = tmp_path / "program.py"
        program.write_text(textwrap.dedent(PROGRAM))
        process = subprocess.Popen(
            [sys.executable, str(program), *words],
            stdout=subprocess.PIPE,
            text=True,
            env={"PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "src")))},
        )
        started.append(process)
        assert process.stdout
        assert process.stdout.readline() == "running\n"
        return process

    yield call
    for process in started:
        with process:  # its output is closed, and it is waited for
            process.kill()


def test_the_programs_own_way_with_signals_comes_back(around: Around) -> None:
    """What embeds us ends by Ctrl-C again once the run is over."""
    usual = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    during: list[Any] = []

    def work(job: JobContext) -> None:
        during.append((signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)))

    run_steps(Jobs((make_job("j", work),)), around)
    assert during[0][0] != usual[0]
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == usual


def test_no_signal_has_to_wait_for_the_jobs_end(
    around: Around, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that comes just before Python falls asleep is heard when it wakes up: soon."""
    waits: list[float | None] = []

    class Queue(queue.SimpleQueue[Any]):
        def get(self, block: bool = True, timeout: float | None = None) -> Any:  # noqa: FBT001, FBT002
            waits.append(timeout)
            return super().get(block, timeout)

    monkeypatch.setattr(engine, "LOOK", 0.01)
    monkeypatch.setattr(queue, "SimpleQueue", Queue)
    run_steps(Jobs((make_job("j", lambda job: until(lambda: len(waits) > 2, "waits")),)), around)
    assert len(waits) > 2
    assert all(timeout is not None and timeout <= 0.01 for timeout in waits)


@pytest.mark.programs
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_stops_its_jobs_and_disconnects(
    start: Start, number: signal.Signals
) -> None:
    """Ctrl-C and SIGTERM: the job cleans up, then the provider is let go."""
    process = start("listens", "20")
    process.send_signal(number)
    output, _ = process.communicate(timeout=120)
    assert output.splitlines() == [
        "warn stopping job work; Ctrl-C again ends at once",
        "cleaned up",
        "disconnected robot",
        "interrupted ()",
    ]
    assert process.returncode == 130


@pytest.mark.programs
def test_a_second_interrupt_ends_at_once(start: Start) -> None:
    """A job that does not listen cannot hold the terminal."""
    process = start("deaf", "600")
    process.send_signal(signal.SIGINT)
    assert process.stdout
    assert process.stdout.readline().startswith("warn stopping job work")
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    assert "interrupted twice" in output
    assert "still running: job work" in output
    assert process.returncode == 130


@pytest.mark.programs
def test_an_interrupted_job_that_does_not_listen_is_left_after_the_grace(start: Start) -> None:
    """The provider is disconnected all the same, and what was left is named."""
    process = start("deaf", "0.1")
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    assert output.splitlines()[1:] == [
        "warn job work did not stop within 0.1 s and was abandoned",
        "disconnected robot",
        "interrupted ('still running: job work',)",
    ]
    assert process.returncode == 130
