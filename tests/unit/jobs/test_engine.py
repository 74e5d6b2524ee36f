"""Order, side-by-side branches, dependencies, failures."""

from __future__ import annotations

import threading
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import Interrupted, JobFailed, RigelK8sError, UserError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.steps import Jobs, Serving
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.settings import Settings
from tests.support.recorder import Recorder

from .conftest import Around, Meeting, make_branches, make_job, run_steps


def until_cancelled(job: JobContext) -> None:
    assert job.cancel.wait(20), "the job was never told to stop"


def broken(job: JobContext) -> None:
    raise RigelK8sError("the registry is full", hint="make room", details=["0 bytes left"])


def test_jobs_run_in_order_and_see_what_earlier_ones_stored(around: Around) -> None:
    """A job stores, the next one reads, and the whole is returned."""

    def first(job: JobContext) -> None:
        job.data["image"] = "talker@sha256:1"

    def second(job: JobContext) -> None:
        job.data["deployed"] = job.data["image"]

    data = run_steps(Jobs((make_job("build", first), make_job("deploy", second))), around)
    assert data == {"image": "talker@sha256:1", "deployed": "talker@sha256:1"}


def test_branches_run_side_by_side_each_with_its_own_data(around: Around, told: Recorder) -> None:
    """One branch per combination, all at once; none sees another's data, the trunk sees none."""
    meet, seen, lock = Meeting(4), [], threading.Lock()

    def work(job: JobContext) -> None:
        meet()
        job.data["shared"].append(job.data["distro"])
        meet()
        with lock:
            seen.append((job.data["distro"], job.data["arch"], job.data["shared"]))
        job.report.line("built")

    def store(job: JobContext) -> None:
        job.data["shared"] = []

    body = Jobs((make_job("build", work),))
    matrix = {"distro": ["noetic", "melodic"], "arch": ["arm64", "amd64"]}
    data = run_steps(Jobs((make_job("first", store), make_branches(matrix, body))), around)
    assert sorted(seen) == [
        ("melodic", "amd64", ["melodic"]),
        ("melodic", "arm64", ["melodic"]),
        ("noetic", "amd64", ["noetic"]),
        ("noetic", "arm64", ["noetic"]),
    ]
    assert data == {"shared": []}
    paths = {path for path, kind, _ in told.entries if kind == "line"}
    assert "/distro=noetic, arch=arm64/build" in paths
    assert len(paths) == 4


def test_a_failure_in_one_branch_stops_the_others_and_the_sequence(
    around: Around, told: Recorder
) -> None:
    """The other branch is cancelled, no later stage runs, the error names job and branch.

    Progress ends with failed for the culprit, with stopped for the others.
    """
    meet, later = Meeting(2), []

    def work(job: JobContext) -> None:
        meet()
        broken(job) if job.data["robot"] == "r2" else until_cancelled(job)

    steps = Jobs(
        (
            make_branches({"robot": ["r1", "r2"]}, Jobs((make_job("deploy", work),))),
            make_job("later", lambda job: later.append(1)),
        )
    )
    with pytest.raises(JobFailed) as caught:
        run_steps(steps, around)
    assert caught.value.message == "job deploy (robot=r2): the registry is full"
    assert (caught.value.hint, caught.value.details) == ("make room", ("0 bytes left",))
    assert type(caught.value.__cause__) is RigelK8sError
    assert caught.value.exit_code == 1
    assert later == []
    assert ("/robot=r2", "progress", "deploy: failed") in told.entries
    assert ("/robot=r1", "progress", "deploy: stopped") in told.entries


def test_an_error_of_the_user_keeps_exit_code_two(around: Around) -> None:
    """A UserError inside a job still says that the user wrote it."""

    def work(job: JobContext) -> None:
        raise UserError("no such image")

    with pytest.raises(JobFailed) as caught:
        run_steps(Jobs((make_job("build", work),)), around)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("error", [ValueError("odd"), SystemExit(3), KeyboardInterrupt()])
def test_a_bug_in_a_job_is_a_failure_with_its_traceback(
    around: Around, error: BaseException
) -> None:
    """Whatever a job raises stops the sequence and is kept; exit() in a job ends no program."""

    def work(job: JobContext) -> None:
        raise error

    with pytest.raises(JobFailed, match="job build broke") as caught:
        run_steps(Jobs((make_job("build", work),)), around)
    assert caught.value.__cause__ is error
    assert any("in work" in line for line in caught.value.details)


def test_dependencies_serve_until_the_jobs_have_ended(around: Around) -> None:
    """A dependency is ready before the first job, runs beside it, and is stopped after the last."""
    events: list[str] = []

    def serve(job: JobContext) -> None:
        assert job.serving
        events.append("serves")
        job.ready.set()
        until_cancelled(job)
        events.append("stopped")

    jobs = Jobs(tuple(make_job(n, lambda job, n=n: events.append(n)) for n in ("one", "two")))
    run_steps(Jobs((Serving((make_job("master", serve),), jobs),)), around)
    assert events == ["serves", "one", "two", "stopped"]


def test_a_dependency_that_returns_is_ready(around: Around) -> None:
    """Work that lasts by itself (a deploy) needs no thread: the jobs start when it has returned."""
    events: list[str] = []
    dependency = make_job("deploy", lambda job: events.append("deployed"))
    jobs = Jobs((make_job("check", lambda job: events.append("checked")),))
    run_steps(Jobs((Serving((dependency,), jobs),)), around)
    assert events == ["deployed", "checked"]


def test_a_dependency_that_fails_before_it_is_ready_keeps_the_jobs_from_running(
    around: Around,
) -> None:
    """Nothing runs on a dependency that is not there."""
    ran: list[int] = []
    step = Serving(
        (make_job("master", broken),), Jobs((make_job("test", lambda _: ran.append(1)),))
    )
    with pytest.raises(JobFailed, match="job master: the registry is full"):
        run_steps(Jobs((step,)), around)
    assert ran == []


def test_a_dependency_that_fails_later_stops_the_jobs(around: Around) -> None:
    """The job is cancelled although it did nothing wrong, and the dependency is named."""
    started = threading.Event()

    def serve(job: JobContext) -> None:
        job.ready.set()
        assert started.wait(20)
        raise RigelK8sError("roscore died")

    def test(job: JobContext) -> None:
        started.set()
        until_cancelled(job)

    step = Serving((make_job("master", serve),), Jobs((make_job("test", test),)))
    with pytest.raises(JobFailed, match="job master: roscore died"):
        run_steps(Jobs((step,)), around)


def test_a_dependency_that_fails_while_it_stops_fails_the_sequence(around: Around) -> None:
    """What a dependency could not clean up is no success."""

    def serve(job: JobContext) -> None:
        job.ready.set()
        until_cancelled(job)
        raise RigelK8sError("the recording is cut off")

    step = Serving((make_job("record", serve),), Jobs((make_job("drive", lambda job: None),)))
    with pytest.raises(JobFailed, match="job record: the recording is cut off"):
        run_steps(Jobs((step,)), around)


def test_a_job_that_fails_stops_its_dependencies(around: Around, told: Recorder) -> None:
    """The dependency ends before the error is raised; its Interrupted is no failure of its own."""
    ended: list[int] = []

    def serve(job: JobContext) -> None:
        job.ready.set()
        until_cancelled(job)
        ended.append(1)
        raise Interrupted("stopped")

    step = Serving((make_job("master", serve),), Jobs((make_job("test", broken),)))
    with pytest.raises(JobFailed, match="job test: the registry is full"):
        run_steps(Jobs((step,)), around)
    assert ended == [1]
    assert told.of("warn") == []


def test_a_dependency_that_is_never_ready_fails_with_the_way_out(around: Around) -> None:
    """The wait for `ready` is bounded by --timeout, and the hint says what sets it."""
    step = Serving((make_job("master", until_cancelled),), Jobs(()))
    around = attrs.evolve(around, settings=Settings(timeout=0.05))
    with pytest.raises(
        JobFailed, match=r"dependency master: .*neither ready nor finished"
    ) as caught:
        run_steps(Jobs((step,)), around)
    assert "job.ready" in str(caught.value.hint)


def test_a_dependency_that_does_not_stop_is_told(around: Around) -> None:
    """A dependency that ignores `cancel` fails the sequence instead of hanging it."""
    release = threading.Event()

    def serve(job: JobContext) -> None:
        job.ready.set()
        release.wait(20)

    step = Serving((make_job("deaf", serve),), Jobs((make_job("test", lambda job: None),)))
    with pytest.raises(JobFailed, match="dependency deaf: it did not stop within"):
        run_steps(Jobs((step,)), attrs.evolve(around, grace=0.05))
    release.set()


def test_a_job_that_gives_up_by_itself_is_a_failure(around: Around) -> None:
    """Interrupted, raised by a job that nobody stopped, is no silent success."""

    def work(job: JobContext) -> None:
        raise Interrupted("the terminal was closed")

    with pytest.raises(JobFailed, match="the terminal was closed"):
        run_steps(Jobs((make_job("shell", work),)), around)


def test_a_part_of_a_stopped_run_is_stopped_from_its_start() -> None:
    """A branch that starts while Ctrl-C is handled must not run on."""
    scope = CancelScope()
    early = scope.part().part()
    calls: list[int] = []
    scope.on_cancel(lambda: calls.append(1))
    scope.cancel()
    scope.cancel()
    scope.on_cancel(lambda: calls.append(2))
    assert early.cancelled.is_set()
    assert scope.part().cancelled.is_set()
    assert calls == [1, 2]


def test_what_goes_wrong_after_the_first_failure_is_told(around: Around, told: Recorder) -> None:
    """The first failure is raised; one of a job that was being stopped is a warning."""
    meet = Meeting(2)

    def work(job: JobContext) -> None:
        meet()
        if job.data["robot"] == "r1":
            broken(job)
        until_cancelled(job)
        raise RigelK8sError("the lease is not given back")

    body = Jobs((make_job("deploy", work),))
    with pytest.raises(JobFailed, match="registry is full"):
        run_steps(Jobs((make_branches({"robot": ["r1", "r2"]}, body),)), around)
    warned = "job deploy (robot=r2), while it was stopped: the lease is not given back"
    assert told.of("warn") == [warned]


def test_an_empty_matrix_runs_nothing_and_says_so(around: Around, told: Recorder) -> None:
    """No combination, no branch; the user is told, since it may not be meant."""
    ran: list[int] = []
    body = Jobs((make_job("build", lambda job: ran.append(1)),))
    run_steps(Jobs((make_branches({"distro": []}, body),)), around)
    assert ran == []
    assert told.of("warn") == ["the matrix has no combinations: its stages do not run"]


def test_branches_inside_branches_name_both_combinations(around: Around) -> None:
    """A sequence's own matrix around a stage's: the error names the whole branch."""

    def work(job: JobContext) -> None:
        if (job.data["site"], job.data["robot"]) == ("b", 2):
            broken(job)

    inner = make_branches({"robot": [1, 2]}, Jobs((make_job("deploy", work),)))
    with pytest.raises(JobFailed, match=r"job deploy \(site=b, robot=2\)"):
        run_steps(Jobs((make_branches({"site": ["a", "b"]}, Jobs((inner,))),)), around)


def test_two_running_jobs_with_one_key_are_refused(around: Around) -> None:
    """What only the data tells (a release's name) is refused when the second job starts."""
    meet = Meeting(2)
    arrived: list[Any] = []

    def pick(job: JobContext) -> None:
        meet()
        job.data["release"] = "demo"

    def deploy(job: JobContext) -> None:
        arrived.append(job.data["robot"])
        until_cancelled(job)

    jobs = (make_job("pick", pick), make_job("deploy", deploy, alone=lambda o: o["release"]))
    with pytest.raises(JobFailed, match=r"job deploy \(robot=.\) works on demo") as caught:
        run_steps(Jobs((make_branches({"robot": [1, 2]}, Jobs(jobs)),)), around)
    assert caught.value.exit_code == 2
    assert len(arrived) == 1


def test_a_key_is_free_again_when_its_job_has_ended(around: Around) -> None:
    """src.plugin's deploy and update are two jobs on one release, one after the other."""
    jobs = [make_job(n, lambda job: None, alone=lambda o: "demo") for n in ("deploy", "update")]
    run_steps(Jobs(tuple(jobs)), around)
