"""What is said of a release's pods."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.release.status import describe_pod

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
