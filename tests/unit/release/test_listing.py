"""What `rigel list` says of releases, out of their newest revisions and their workloads."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import RolloutFailed
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.controllers import Controllers, unready
from tests.support.manifests import RELEASE, config, desired, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy


def test_a_release_is_told_by_its_newest_revision(fake: Any, report: Recorder) -> None:
    """Revision 10 is newer than revision 9, and what is ready is counted."""
    for number in range(10):
        made = desired(workload(), workload("listener"), config(number=str(number)))
        deploy(made, fake, report=report, description="deploy")
    (one,) = list_releases(fake, RELEASE.namespace)
    assert (one.release, one.revision, one.status) == (RELEASE, 10, "good")
    assert (one.ready, one.workloads, one.description) == (2, 2, "deploy")


def test_a_release_that_failed_says_so_and_counts_what_is_ready(
    fake: Any, report: Recorder
) -> None:
    deploy(desired(workload("ready")), fake, report=report)
    fake.store.controllers = Controllers(unready)
    with pytest.raises(RolloutFailed):
        deploy(desired(workload("ready"), workload("late")), fake, report=report, timeout=0.1)
    (one,) = list_releases(fake, RELEASE.namespace)
    assert (one.revision, one.status, one.ready < one.workloads) == (2, "failed", True)


def test_a_namespace_shows_its_own_releases_and_the_cluster_all(
    fake: Any, report: Recorder
) -> None:
    other = Desired(ReleaseId("elsewhere", "arm"), (), create_namespace=True)
    deploy(desired(workload()), fake, report=report)
    deploy(other, fake, report=report)
    assert [one.release.name for one in list_releases(fake, "elsewhere")] == ["arm"]
    found = [(one.release, one.workloads) for one in list_releases(fake, None)]
    assert found == [(other.release, 0), (RELEASE, 1)]


def test_the_requests_do_not_grow_with_the_releases(fake: Any, report: Recorder) -> None:
    """Revisions come in one LIST, each kind of workload in another."""
    counts = []
    for number in range(3):
        made = Desired(ReleaseId(f"space{number}", "arm"), (), create_namespace=True)
        deploy(made, fake, report=report)
        fake.store.calls.clear()
        list_releases(fake, None)
        counts.append(len(fake.store.calls))
    assert counts == [5, 5, 5]
