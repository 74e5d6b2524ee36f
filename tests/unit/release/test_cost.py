"""What a deploy costs grows with its objects, and no faster; counted in calls of functions."""

from __future__ import annotations

import cProfile
import pstats
from collections.abc import Callable, Iterable
from typing import TypeVar

import pytest

from rigel_k8s.release.listing import list_releases
from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Store
from tests.support.manifests import RELEASE, desired, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, down

T = TypeVar("T")
R = TypeVar("R")
#: What looks and writes; how often a wait looks again depends on the machine.
PARTS = ("survey", "plan", "ownership", "prepare", "apply", "revisions", "listing", "removal")
STEPS = ("first", "unchanged", "one image", "list", "down")


class OneThread(FakeCluster):
    """A cluster whose requests follow each other, so that all calls are counted."""

    def parallel(
        self, function: Callable[[T], R], items: Iterable[T], *, width: int = 1
    ) -> list[R]:
        return [function(item) for item in items]


def count_calls(work: Callable[[], object]) -> int:
    """Return how often functions of those parts are called: the same on any machine."""
    profile = cProfile.Profile()
    profile.enable()
    work()
    profile.disable()
    stats: dict[tuple[str, int, str], tuple[int, int]] = vars(pstats.Stats(profile))["stats"]
    files = tuple(f"/rigel_k8s/release/{part}.py" for part in PARTS)
    return sum(calls[1] for (file, _, _), calls in stats.items() if file.endswith(files))


def cost(count: int) -> dict[str, int]:
    """Return what each step costs for a release of so many workloads."""
    fake, report = OneThread(Store(controllers=Controllers())), Recorder()
    fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
    plain = [workload(f"n{number}") for number in range(count)]
    changed = [workload("n0", "app:2"), *plain[1:]]
    deploys = [
        lambda o=o: deploy(desired(*o), fake, report=report) for o in (plain, plain, changed)
    ]
    work = [*deploys, lambda: list_releases(fake, "n")]
    work.append(lambda: down(fake, RELEASE, volumes=False, report=report))
    return dict(zip(STEPS, map(count_calls, work), strict=True))


def test_a_workload_costs_the_same_among_few_and_among_many() -> None:
    """No step reads everything again for each of its objects."""
    few, more, many = map(cost, (5, 25, 45))
    for step in STEPS:
        first, then = more[step] - few[step], many[step] - more[step]
        assert then == pytest.approx(first, rel=0.05), step
