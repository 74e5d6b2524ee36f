"""Going back after a failure: what became of it is part of the error."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, Interrupted, RolloutFailed
from rigel_k8s.release.deploy import deploy, history
from rigel_k8s.release.rollback import undo
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired

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


def test_an_interruption_is_not_a_failed_rollback(fake: FakeCluster, report: Any) -> None:
    """It has an exit code of its own, and says what state is left."""
    deploy(desired(config(k="1")), fake, report=report)
    deploy(desired(config(k="2")), fake, report=report)
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(Interrupted):
        go_back(fake, report, 1, cancel=cancel)
