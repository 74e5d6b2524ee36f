"""A matrix in waves: how many at once, when it stops, and what is said of each branch."""

from __future__ import annotations

import threading

import attrs
import pytest

from rigel_k8s.errors import Interrupted, JobFailed, RigelK8sError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.steps import Jobs
from rigel_k8s.jobs.stopping import CancelScope
from tests.support.recorder import Recorder

from .conftest import Around, Meeting, Work, make_branches, make_job, run_steps

ROBOTS = [f"r{number}" for number in range(1, 8)]


def fleet(work: Work, *, robots: list[str] = ROBOTS, **limits: int) -> Jobs:
    """Deploy to robots, within limits."""
    matrix = {"robot": robots, **{key: [value] for key, value in limits.items()}}
    return Jobs((make_branches(matrix, Jobs((make_job("deploy", work),))),))


def failing(*robots: str) -> tuple[Work, list[str]]:
    """Return work that fails on some robots, and the robots on which it was begun."""
    begun: list[str] = []

    def work(job: JobContext) -> None:
        begun.append(job.data["robot"])
        if job.data["robot"] in robots:
            raise RigelK8sError("no pod can be made", hint="free some memory", details=["quota"])

    return work, begun


def test_a_wave_begins_when_the_one_before_has_ended(around: Around, told: Recorder) -> None:
    """Three at once, never four, and none of the next while one of these still works."""
    waves = [Meeting(3), Meeting(3), Meeting(1)]
    running: list[int] = []
    most: list[int] = []

    def work(job: JobContext) -> None:
        running.append(1)
        waves[ROBOTS.index(job.data["robot"]) // 3]()
        most.append(len(running))
        running.pop()

    run_steps(fleet(work, max_parallel=3), around)
    assert max(most) <= 3
    assert told.lines == [
        "wave 1 of 3: robot=r1; robot=r2; robot=r3",
        "wave 2 of 3: robot=r4; robot=r5; robot=r6",
        "wave 3 of 3: robot=r7",
        "7 in all: 7 done",
    ]


def test_limits_are_no_part_of_a_combination(around: Around) -> None:
    """Neither a branch's name nor its data has them."""
    seen: list[dict[str, object]] = []
    run_steps(fleet(lambda job: seen.append(dict(job.data)), max_parallel=4), around)
    assert {"robot": "r1"} in seen


def test_a_failure_stops_no_robot_of_its_wave_and_the_next_wave_does_not_begin(
    around: Around,
) -> None:
    """A robot that is half updated because of another one would be worse than both."""
    meet, ended, threads = Meeting(3), [], list[threading.Thread]()

    def work(job: JobContext) -> None:
        if job.data["robot"] == "r1":
            threads.append(threading.current_thread())
        meet()
        if job.data["robot"] == "r1":
            raise RigelK8sError("no pod can be made", hint="free some memory", details=["quota"])
        threads[0].join(60)  # whatever the failure stops, it has stopped then
        assert not threads[0].is_alive()
        assert not job.cancel.is_set()
        ended.append(job.data["robot"])

    with pytest.raises(JobFailed) as caught:
        run_steps(fleet(work, max_parallel=3), around)
    assert sorted(ended) == ["r2", "r3"]
    assert (caught.value.message, caught.value.exit_code) == ("1 of 7 branches failed", 1)
    assert caught.value.details == (
        "done: robot=r2; robot=r3",
        "not begun: robot=r4; robot=r5; robot=r6; robot=r7",
        "failed: job deploy (robot=r1): no pod can be made",
        "  quota",
        "  hint: free some memory",
    )


@pytest.mark.parametrize(("limit", "begun"), [(1, 2), (2, 4), (3, 7)])
def test_as_many_robots_may_fail_as_is_said(around: Around, limit: int, begun: int) -> None:
    """r2 and r3 fail, in two waves of two; the third wave begins where three may fail."""
    work, seen = failing("r2", "r3")
    with pytest.raises(JobFailed):
        run_steps(fleet(work, max_parallel=2, stop_after_failures=limit), around)
    assert len(seen) == begun


def test_without_max_parallel_all_are_one_wave(around: Around) -> None:
    """`stop_after_failures` alone lets the others go on."""
    work, seen = failing("r1")
    with pytest.raises(JobFailed, match="1 of 7 branches failed"):
        run_steps(fleet(work, stop_after_failures=1), around)
    assert sorted(seen) == ROBOTS


def test_what_comes_after_a_fleet_that_failed_does_not_run(around: Around) -> None:
    work, _ = failing("r7")
    later: list[int] = []
    steps = Jobs((*fleet(work, max_parallel=3).steps, make_job("later", lambda _: later.append(1))))
    with pytest.raises(JobFailed, match="1 of 7 branches failed"):
        run_steps(steps, around)
    assert later == []


def test_an_interruption_says_what_is_done_stopped_and_not_begun(
    around: Around, told: Recorder
) -> None:
    """Of a wave that is stopped, a robot that was done before is done."""
    scope, meet, threads = CancelScope(), Meeting(2), list[threading.Thread]()

    def work(job: JobContext) -> None:
        if job.data["robot"] == "r3":
            threads.append(threading.current_thread())
            meet()
        elif job.data["robot"] == "r4":
            meet()
            threads[0].join(20)
            scope.cancel()
            raise Interrupted("stopped")

    with pytest.raises(Interrupted):
        run_steps(fleet(work, robots=ROBOTS[:5], max_parallel=2), around, scope=scope)
    assert told.warnings[-1].splitlines() == [
        "5 in all: 3 done, 1 stopped, 1 not begun",
        "done: robot=r1; robot=r2; robot=r3",
        "stopped: robot=r4",
        "not begun: robot=r5",
    ]


def test_an_interruption_between_two_waves_begins_nothing(around: Around) -> None:
    """The first wave is done, the second one does not begin, and no job was stopped."""
    scope, meet = CancelScope(), Meeting(2)

    class Cancelling(Recorder):
        def line(self, text: str) -> None:
            super().line(text)
            if text.startswith("wave 2"):
                scope.cancel()

    begun: list[str] = []

    def work(job: JobContext) -> None:
        begun.append(job.data["robot"])
        meet()

    report = Cancelling()
    with pytest.raises(Interrupted):
        run_steps(
            fleet(work, robots=ROBOTS[:4], max_parallel=2),
            attrs.evolve(around, report=report),
            scope=scope,
        )
    assert sorted(begun) == ["r1", "r2"]
    assert report.warnings[-1].splitlines()[0] == "4 in all: 2 done, 2 not begun"
