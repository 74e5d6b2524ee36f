"""Whether a container's log goes on, asked of a small server that is as slow as a busy machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_k8s.kube import cluster as pods
from rigel_k8s.kube.cluster import Cluster
from tests.support.http_server import Exchange

SLOW = 60.0  # seconds that an answer takes by the clock of the one who asks
CONTAINER = ("n", "talker", "node")


@pytest.fixture
def kubelet(serve: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Cluster]:
    """Return what starts a slow kubelet behind an API server.

    A log that is followed ends a tenth of a second after it was asked for, or with its container.
    """

    def start(*, runs: threading.Event | None = None, status: int = 200) -> Cluster:
        now = [0.0]
        monkeypatch.setattr(pods, "time", SimpleNamespace(monotonic=lambda: now[0]))

        def answer(exchange: Exchange) -> None:
            if "follow" not in exchange.request_.query:
                now[0] += 0.0 if runs else SLOW
            elif runs:
                runs.wait(60)
            else:
                time.sleep(0.1)
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
