"""What a deploy's caller looks at before the first write, and after the roll-out."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.release.revisions import find_last_good, history
from rigel_k8s.release.types import Plan
from tests.support.manifests import RELEASE, config, desired, workload
from tests.support.releases import deploy, rollback


def statuses(fake: Any) -> list[str]:
    return [revision.status for revision in history(fake, RELEASE)]


def test_the_plan_is_known_before_anything_of_it_is_written(fake: Any, report: Any) -> None:
    """With the Lease held: no other deploy changes the cluster meanwhile."""
    seen: list[tuple[list[str], list[str]]] = []

    def before(plan: Plan) -> None:
        written = [ref.name for _, ref in fake.writes]
        seen.append(([step.ref.name for step in plan.changes], written))

    deploy(desired(config("a")), fake, report=report, before=before)
    assert seen == [(["a"], ["rigel.demo"])]


def test_nothing_is_asked_of_an_unchanged_release(fake: Any, report: Any) -> None:
    deploy(desired(workload()), fake, report=report)

    def fail(*_: Any) -> None:
        pytest.fail("called")

    deploy(desired(workload()), fake, report=report, before=fail, verify=fail)


def test_the_caller_learns_that_only_the_wait_is_left(fake: Any, report: Any) -> None:
    """Also where nothing had to be written: it may be that what is there is not ready."""
    seen: list[tuple[set[str], list[str]]] = []

    def applied() -> None:
        seen.append((fake.names("Deployment"), statuses(fake)))

    deploy(desired(workload()), fake, report=report, applied=applied)
    deploy(desired(workload()), fake, report=report, applied=applied)
    assert seen == [({"talker"}, ["pending"]), ({"talker"}, ["good"])]


def test_a_release_is_verified_when_all_is_ready_and_pruned(fake: Any, report: Any) -> None:
    """Until then it is not good."""
    deploy(desired(config("old")), fake, report=report)
    seen: list[Any] = []

    def verify() -> None:
        seen.append((fake.names("ConfigMap"), statuses(fake)))

    deploy(desired(config("new")), fake, report=report, verify=verify)
    assert seen == [({"new"}, ["good", "pending"])]
    assert statuses(fake) == ["superseded", "good"]


def test_what_the_verification_refuses_has_failed(fake: Any, report: Any) -> None:
    """The last good revision is the one before, and a rollback goes there."""
    deploy(desired(config("a", k="1")), fake, report=report)

    def verify() -> None:
        raise RigelK8sError("worse")

    with pytest.raises(RigelK8sError, match="worse"):
        deploy(desired(config("a", k="2")), fake, report=report, verify=verify)
    assert statuses(fake) == ["good", "failed"]
    last = find_last_good(fake, RELEASE)
    assert last is not None
    assert last.number == 1
    assert rollback(fake, RELEASE, 1, report=report).number == 3
    assert statuses(fake) == ["superseded", "failed", "good"]


def test_a_failure_before_the_first_write_leaves_no_revision(fake: Any, report: Any) -> None:
    def before(plan: Plan) -> None:
        raise RigelK8sError("no")

    with pytest.raises(RigelK8sError):
        deploy(desired(config("a")), fake, report=report, before=before)
    assert statuses(fake) == []
    assert fake.names("Lease", "ConfigMap") == set()
