"""Whether a container's log goes on, asked of a small server that is as slow as a busy machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.kube.cluster import Cluster
from tests.support.http_server import Exchange

SLOW = 0.05  # seconds that an answer takes
CONTAINER = ("n", "talker", "node")


@pytest.fixture
def kubelet(serve: Any) -> Callable[..., Cluster]:
    """Return what starts a slow kubelet behind an API server.

    A log that is followed ends twice as slowly as others, or with its container.
    """

    def start(*, runs: threading.Event | None = None, status: int = 200) -> Cluster:
        def answer(exchange: Exchange) -> None:
            follows = "follow" in exchange.request_.query
            if follows and runs is not None:
                runs.wait(60)
            time.sleep(2 * SLOW if follows else SLOW)
            exchange.say(status)

        cluster: Cluster = serve(answer)[0]
        return cluster

    return start


def test_a_slow_machine_gets_the_time_to_tell_of_an_end(kubelet: Any) -> None:
    """A fiftieth of a second is much where answers are quick; here it would end before the log."""
    assert not kubelet().runs(*CONTAINER, seconds=0.02)


def test_a_container_that_runs_is_not_waited_for_for_ever(kubelet: Any) -> None:
    """Its log does not end as long as it runs."""
    runs = threading.Event()
    assert kubelet(runs=runs).runs(*CONTAINER, seconds=0.02)
    runs.set()


@pytest.mark.parametrize("status", [403, 404, 500])
def test_who_may_not_read_logs_knows_nothing(kubelet: Any, status: int) -> None:
    """That is no reason to call a node ended."""
    assert kubelet(status=status).runs(*CONTAINER, seconds=0.02)
