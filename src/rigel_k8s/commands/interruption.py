"""Ctrl-C as an event for work that ends cleanly, such as writes; a second one ends at once."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

from rigel_k8s import signals
from rigel_k8s.jobs.stopping import CancelScope, interruptions
from rigel_k8s.kube import Cluster
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings

TWICE = (
    "interrupted twice, stopped without waiting; run the same command again to complete its work"
)


@contextmanager
def interruptible(scope: CancelScope | None = None) -> Iterator[threading.Event]:
    """Give an event that Ctrl-C or SIGTERM sets; the second one ends the process.

    Args:
        scope: what the first one stops.
    """
    stopped = scope or CancelScope()
    calls = itertools.count()

    def notify() -> None:
        if next(calls):
            signals.end_at_once(TWICE)
        # Event.set takes a lock that the interrupted main thread may hold in this very moment.
        threading.Thread(target=stopped.cancel).start()

    with interruptions(notify):
        yield stopped.cancelled


@contextmanager
def writing(
    cluster: Cluster, settings: Settings, report: Reporter, cancel: threading.Event | None = None
) -> Iterator[DeployOptions]:
    """Give the options of a command that writes; closes the connection at the end.

    It waits for an API server that becomes unreachable.

    Args:
        cancel: ends it in good order; None: Ctrl-C does.
    """
    with cluster, nullcontext(cancel) if cancel else interruptible() as over:
        cluster.endure(report.line, over)
        yield DeployOptions.of(settings, report, over)
