"""Where a step runs: its data, its reporter, what stops it, and how far its failure reaches."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from typing import Any

import attrs

from rigel_k8s.errors import JobFailed, RigelK8sError, UserError
from rigel_k8s.jobs.job import JobReporter


class CancelScope:
    """A part of a run that can be stopped: sets `cancelled`, also of all its parts."""

    def __init__(self) -> None:
        self.cancelled = threading.Event()
        self._parts: list[CancelScope] = []
        self._callbacks: list[Callable[[], None]] = []
        self._lock = threading.RLock()  # cancel() may come from a signal handler

    def on_cancel(self, notify: Callable[[], None]) -> None:
        """Call a function when this is cancelled; at once if it is already."""
        with self._lock:
            self._callbacks.append(notify)
            cancelled = self.cancelled.is_set()
        if cancelled:
            notify()

    def part(self) -> CancelScope:
        """Return a new part; if the scope is already cancelled, so is the part."""
        part = CancelScope()
        with self._lock:
            self._parts.append(part)
            if self.cancelled.is_set():
                part.cancelled.set()
        return part

    def cancel(self) -> None:
        """Stop this and all parts."""
        with self._lock:
            first = not self.cancelled.is_set()
            self.cancelled.set()
            parts, callbacks = tuple(self._parts), tuple(self._callbacks)
        for notify in callbacks if first else ():
            notify()
        for part in parts:
            part.cancel()


class Boundary:
    """How far a failure reaches: the first one is kept, and stops everything inside."""

    def __init__(self, scope: CancelScope) -> None:
        self.scope = scope
        self.failure: JobFailed | None = None
        self._lock = threading.Lock()

    def take(self, failure: JobFailed) -> bool:
        """Keep a failure; False if one was kept before, or everything was already stopped."""
        with self._lock:
            first = self.failure is None and not self.scope.cancelled.is_set()
            if first:
                self.failure = failure
        if first:
            self.scope.cancel()
        return first


@attrs.frozen(eq=False)
class Branch:
    """Where a step runs: its name ("" is the trunk), its own data, its reporter, what stops it."""

    name: str
    data: dict[str, Any]
    report: JobReporter
    scope: CancelScope
    boundary: Boundary


class Stopped(Exception):
    """Unwinds a thread after the run was cancelled; the reason is with what cancelled it."""


def describe(branch: Branch) -> str:
    """Return a branch's name for the end of a sentence, "" for the trunk."""
    return f" ({branch.name})" if branch.name else ""


def summarise_error(error: BaseException) -> str:
    """Return an error in one line."""
    return error.message if isinstance(error, RigelK8sError) else f"{type(error).__name__}: {error}"


def make_failure(where: str, error: BaseException) -> JobFailed:
    """Return the failure that names the job; a bug's traceback is kept in its details."""
    if isinstance(error, RigelK8sError):
        failed = JobFailed(f"{where}: {error.message}", hint=error.hint, details=error.details)
        failed.exit_code = 2 if isinstance(error, UserError) else 1
    else:
        lines = "".join(traceback.format_exception(error)).splitlines()
        failed = JobFailed(f"{where} broke: {summarise_error(error)}", details=lines)
    failed.__cause__ = error
    return failed
