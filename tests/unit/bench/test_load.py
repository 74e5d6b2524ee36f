"""What the bench of an overloaded machine counts."""

from __future__ import annotations

from typing import Any

import pytest

from bench.load import Ledger, judge_calls, longest_gap


def pod(ready: str, restarts: int = 2) -> dict[str, Any]:
    """Return a pod as the API server sends it."""
    return {
        "metadata": {"name": "talker-1"},
        "status": {
            "conditions": [{"type": "Ready", "status": ready}],
            "containerStatuses": [{"restartCount": restarts}],
        },
    }


def test_changes_and_the_time_between_them_are_counted() -> None:
    """An event without a change counts for nothing; restarts from before do not count."""
    ledger = Ledger()
    for now, ready, restarts in [(0, "True", 2), (5, "True", 2), (7, "False", 3), (10, "True", 3)]:
        ledger.note_pod(pod(ready, restarts), float(now))
    [one] = ledger.seen.values()
    assert (one.changes, one.unready, one.restarts) == (2, 3.0, 1)


def test_a_service_is_ready_while_one_endpoint_is() -> None:
    """A lost endpoint is a change."""
    ledger = Ledger()
    meta = {"labels": {"kubernetes.io/service-name": "ros-master"}}
    for now, endpoints in enumerate([[True], [False, True], [False], []]):
        found = {
            "metadata": meta,
            "endpoints": [{"conditions": {"ready": ready}} for ready in endpoints],
        }
        ledger.note_slice(found, float(now))
    one = ledger.seen["Service ros-master"]
    one.settle(5.0)
    assert (one.changes, one.unready) == (1, 3.0)


def test_logs_are_read_from_the_beginning_of_the_load() -> None:
    """What was before does not count."""
    log = "called 1.0 9.5\ncalled 11.0 0.5\nfailed 12.0 TimeoutError()\ncalled 13.0 2.0\n"
    words = "3 calls to the master, 1 failed (most often TimeoutError()), 2.0 s the longest"
    assert judge_calls(log, 10.0) == words
    heard = "heard 1.0\nheard 11.0\nheard 15.5\n"
    assert longest_gap(heard, 10.0, 16.0) == pytest.approx(4.5)
    assert longest_gap(heard, 10.0, 30.0) == pytest.approx(14.5)  # nothing more came
