"""What `rigel status` is made of: pods, where they run, and why one is not ready."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import RolloutFailed, UserError
from rigel_k8s.release.status import ReleaseStatus, status
from tests.support.releases import deploy
from tests.support.until import until

pytestmark = pytest.mark.cluster


def test_status_tells_pods_and_why_one_is_unready(cluster: Any, make: Any, report: Any) -> None:
    """Node, address and revision of what runs; the probe's own words for what is not ready."""
    command = {"command": ["sh", "-c", "echo no master; exit 1"]}
    probe = {"exec": command, "periodSeconds": 1, "timeoutSeconds": 30}
    good, bad = make.deployment("good"), make.deployment("bad", readinessProbe=probe)
    with pytest.raises(RolloutFailed):
        deploy(make.desired(good, bad, make.config()), cluster, report=report, timeout=6)

    def settle() -> ReleaseStatus | None:
        """The status, once one pod is ready and the other one's probe has failed."""
        found = status(cluster, make.release)
        pods = [pod for workload in found.workloads for pod in workload.pods]
        told = [pod.ready or pod.message.startswith("Readiness probe failed") for pod in pods]
        return found if len(pods) == 2 and all(told) and found.workloads[1].done else None

    found = until(settle, "a ready pod and one whose probe fails", 180)
    assert (found.revision, found.revision_status) == (1, "failed")
    assert [(w.name, w.ready, w.desired, w.done) for w in found.workloads] == [
        ("bad", 0, 1, False),
        ("good", 1, 1, True),
    ]
    unready, ready = (workload.pods[0] for workload in found.workloads)
    assert unready.message == "Readiness probe failed: no master"
    assert ready.node
    assert ready.ip
    assert (ready.phase, ready.message) == ("Running", "")


def test_status_of_nothing_says_so(cluster: Any, make: Any) -> None:
    """A release that is not there is the user's mistake."""
    with pytest.raises(UserError, match="there is no release demo"):
        status(cluster, make.release)
