"""What is said of a release's pods."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.release.status import AWAY, describe_pod

UNREADY = {"type": "Ready", "status": "False"}
POD: dict[str, Any] = {
    "kind": "Pod",
    "metadata": {"name": "talker-1", "uid": "u"},
    "spec": {"containers": [{"name": "ros-node", "image": "a"}]},
    "status": {"phase": "Running", "conditions": [UNREADY]},
}


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("Readiness probe failed: /talker is an orphan: restart this pod [orphan]\n", "orphan"),
        ("Readiness probe failed: /talker [x] hangs", ""),
    ],
)
def test_the_kind_that_a_probe_names_is_a_value(said: str, kind: str) -> None:
    """Nobody searches a sentence for it."""
    event = {"reason": "Unhealthy", "message": said, "involvedObject": {"uid": "u"}}
    found = describe_pod(POD, [event])
    assert (found.kind, found.message) == (kind, " ".join(said.split()))


#: As the node controller leaves them when it has lost a machine.
LOST = [UNREADY, {"type": "ContainersReady", "status": "True"}]


@pytest.mark.parametrize(
    ("conditions", "kind"),
    [
        (LOST, AWAY),
        ([{**UNREADY, "reason": "ContainersNotReady"}, {**LOST[1], "status": "False"}], ""),
        ([{**UNREADY, "reason": "ReadinessGatesNotReady"}, LOST[1]], ""),
        ([{**UNREADY, "status": "True"}, LOST[1]], ""),
    ],
)
def test_a_lost_machine_is_told_from_what_its_kubelet_says(
    conditions: list[dict[str, str]], kind: str
) -> None:
    """Without the right to see machines: only the node controller takes Ready alone."""
    pod = {
        **POD,
        "spec": {**POD["spec"], "nodeName": "robot-1"},
        "status": {"phase": "Running", "conditions": conditions},
    }
    found = describe_pod(pod, [])
    assert found.kind == kind
    assert ("cannot reach the machine robot-1" in found.message) is (kind == AWAY)
    ending = {**pod, "metadata": {**POD["metadata"], "deletionTimestamp": "2026-01-01T00:00:00Z"}}
    assert describe_pod(ending, []).message.endswith("cannot be ended") is (kind == AWAY)
