"""Going back after a failure: what became of it is part of the error."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, Interrupted, RolloutFailed
from rigel_k8s.release.revisions import history
from rigel_k8s.release.rollback import find_target
from rigel_k8s.release.status import RolledBack, status
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired
from tests.support.releases import deploy, rollback, undo

FAILURE = RolloutFailed("talker did not become ready", hint="look", details=["its log"])


def go_back(cluster: FakeCluster, report: Any, target: int | None, **more: Any) -> RolloutFailed:
    words: dict[str, Any] = {"cancel": threading.Event(), "timeout": None, "adopt": False, **more}
    return undo(cluster, RELEASE, FAILURE, target, hint="mend it", report=report, **words)  # type: ignore[arg-type]


def test_the_error_names_the_revision_that_runs(fake: FakeCluster, report: Any) -> None:
    deploy(desired(config(k="1")), fake, report=report)
    deploy(desired(config(k="2")), fake, report=report)
    error = go_back(fake, report, 1)
    assert error.message.endswith("did not become ready: rolled back to revision 1, as revision 3")
    assert (error.hint, list(error.details)) == ("mend it", ["its log"])
    assert report.warnings == ["rolling back to revision 1"], "the error has the cause"
    assert [r.status for r in history(fake, RELEASE)] == ["superseded", "superseded", "good"]


def test_without_a_target_everything_is_left(fake: FakeCluster, report: Any) -> None:
    error = go_back(fake, report, None)
    assert "no earlier good revision" in error.message
    assert error.hint == "look"
    assert fake.calls == []


def test_a_rollback_that_fails_is_part_of_the_error(fake: FakeCluster, report: Any) -> None:
    class Away(FakeCluster):
        def create(self, *words: Any, **options: Any) -> Any:
            raise ClusterError("the cluster does not answer")

    deploy(desired(config(k="1")), fake, report=report)
    deploy(desired(config(k="2")), fake, report=report)
    error = go_back(Away(fake.store), report, 1)
    assert "cannot be rolled back to revision 1: the cluster does not answer" in error.message
    assert "`rigel rollback` tries again" in (error.hint or "")
    error = go_back(Away(fake.store), report, 1, names_release=True)
    command = f"rigel rollback --release {RELEASE.name} -n {RELEASE.namespace}"
    assert f"`{command}` tries again" in (error.hint or "")


def test_a_number_wins_over_a_rollback_that_was_interrupted(fake: FakeCluster, report: Any) -> None:
    """Without one the interrupted rollback is finished."""

    class Interrupting(FakeCluster):
        def apply(self, *words: Any, dry_run: bool = False, **options: Any) -> Any:
            if not dry_run:
                raise Interrupted("stopped")
            return super().apply(*words, dry_run=dry_run, **options)

    for number in "123":
        deploy(desired(config(k=number)), fake, report=report)
    with pytest.raises(Interrupted):
        rollback(Interrupting(fake.store), RELEASE, 1, report=report)  # type: ignore[arg-type]
    assert history(fake, RELEASE)[-1].status == "interrupted"
    assert rollback(fake, RELEASE, 2, report=report).back_to == 2  # type: ignore[arg-type]


def test_what_failed_before_it_wrote_has_nothing_to_go_back_from(
    fake: FakeCluster, report: Any
) -> None:
    """The last revision is good: it is what runs."""
    assert find_target(fake, RELEASE) is None  # type: ignore[arg-type]
    deploy(desired(config(k="1")), fake, report=report)
    assert find_target(fake, RELEASE) is None  # type: ignore[arg-type]


def test_an_interruption_is_not_a_failed_rollback(fake: FakeCluster, report: Any) -> None:
    """It has an exit code of its own, and says what state is left."""
    deploy(desired(config(k="1")), fake, report=report)
    deploy(desired(config(k="2")), fake, report=report)
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(Interrupted):
        go_back(fake, report, 1, cancel=cancel)
    assert report.warnings[1:] == ["talker did not become ready\nits log"]


@pytest.mark.parametrize(
    ("detail", "cause"),
    [("/scan: rate 3/s", "the graph is worse; /scan: rate 3/s"), ("    log", "the graph is worse")],
)
def test_status_shows_what_was_rolled_back(
    fake: FakeCluster, report: Any, detail: str, cause: str
) -> None:
    """With its cause but no log, until a newer revision is good; not what a user has undone."""

    def verify() -> None:
        raise RolloutFailed("the graph is worse", details=[detail, "more"])

    deploy(desired(config(k="1")), fake, report=report)
    with pytest.raises(RolloutFailed):
        deploy(desired(config(k="2")), fake, report=report, verify=verify)
    assert status(fake, RELEASE).rolled_back is None  # type: ignore[arg-type]
    rollback(fake, RELEASE, 1, report=report)
    assert status(fake, RELEASE).rolled_back == RolledBack(2, 1, cause)  # type: ignore[arg-type]
    deploy(desired(config(k="3")), fake, report=report)
    assert status(fake, RELEASE).rolled_back is None  # type: ignore[arg-type]
    rollback(fake, RELEASE, 1, report=report)
    assert status(fake, RELEASE).rolled_back is None  # type: ignore[arg-type]
