"""A run from its providers' connection to their disconnection, watched from the main thread.

Jobs run in other threads, so that Ctrl-C reaches the main thread, which can stop them cleanly.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

import attrs

from rigel_k8s.errors import Interrupted, RigelK8sError, UserError
from rigel_k8s.jobs.branches import CancelScope
from rigel_k8s.jobs.execution import Execution, RunContext
from rigel_k8s.jobs.interruption import interruptions
from rigel_k8s.jobs.job import JobReporter, ProviderType
from rigel_k8s.jobs.steps import Jobs

#: Seconds that Python sleeps at most: a signal just before that is handled when it wakes up.
LOOK = 0.5


def run_steps(
    steps: Jobs,
    run: RunContext,
    declared: Sequence[Declared] = (),
    *,
    data: dict[str, Any] | None = None,
    scope: CancelScope | None = None,
) -> dict[str, Any]:
    """Run steps to their end and return the data that the jobs stored.

    Args:
        steps: what to do.
        run: what the run needs from outside; its providers are already connected.
        declared: the providers to connect before and to disconnect after.
        data: what was stored before; jobs write into it.
        scope: what stops the run from outside.

    Raises:
        JobFailed: the first failure; all other jobs were stopped.
        Interrupted: Ctrl-C or SIGTERM; jobs were cancelled and waited for, `grace` seconds at
            most, or not at all after a second one.
    """
    data = {} if data is None else data
    providers = Providers(declared, run.report)
    providers.connections.update(run.providers)
    run = attrs.evolve(run, providers=providers.connections)
    _Live(Execution(run, scope or CancelScope()), run, providers).run(steps, data)
    return data


@attrs.frozen
class Declared:
    """A provider of the Rigelfile with its options, not connected."""

    name: str
    type: ProviderType[Any]
    options: Any


class Providers:
    """Connections by the providers' names; `disconnect` may be called at any time, and twice."""

    def __init__(self, declared: Sequence[Declared], report: JobReporter) -> None:
        self.connections: dict[str, Any] = {}
        self._declared = declared
        self._report = report
        self._open: list[Declared] = []
        self._lock = threading.Lock()
        self._closed = False

    def connect(self, stop: threading.Event) -> None:
        """Connect all in the Rigelfile's order, until `stop` is set.

        Raises:
            RigelK8sError: one could not connect; the error names it.
        """
        for declared in self._declared:
            if stop.is_set():
                return
            try:
                connection = declared.type.connect(declared.options, declared.name, self._report)
            except RigelK8sError as error:
                raise _failure(declared.name, error) from error
            if not self._keep(declared, connection):
                declared.type.disconnect(connection)

    def disconnect(self) -> None:
        """Disconnect all in reverse order; an error is reported and does not stop the others."""
        with self._lock:
            self._closed = True
            ending, self._open = self._open[::-1], []
        for declared in ending:
            try:
                declared.type.disconnect(self.connections[declared.name])
            except Exception as error:
                self._report.warn(f"provider {declared.name} did not disconnect: {error}")

    def _keep(self, declared: Declared, connection: Any) -> bool:
        """Note a connection; False if the run has ended while it was made."""
        with self._lock:
            if not self._closed:
                self.connections[declared.name] = connection
                self._open.append(declared)
            return not self._closed


def _failure(name: str, error: RigelK8sError) -> RigelK8sError:
    kind = UserError if isinstance(error, UserError) else RigelK8sError
    return kind(
        f"provider {name} could not connect: {error.message}",
        hint=error.hint,
        details=error.details,
    )


class _Live:
    def __init__(self, execution: Execution, run: RunContext, providers: Providers) -> None:
        self._execution = execution
        self._run_context = run
        self._providers = providers
        self._mail: queue.SimpleQueue[Literal["ended", "cancelled", "interrupted"]]
        self._mail = queue.SimpleQueue()
        self._interrupted = False
        self._error: BaseException | None = None

    def run(self, steps: Jobs, data: dict[str, Any]) -> None:
        """Connect, work, disconnect, and report how it ended."""
        self._execution.scope.on_cancel(lambda: self._mail.put("cancelled"))
        with interruptions(lambda: self._mail.put("interrupted")):
            self._follow(lambda: self._work(steps, data), "stop")
            self._follow(self._providers.disconnect, "disconnect")
        self._raise()

    def _work(self, steps: Jobs, data: dict[str, Any]) -> None:
        self._providers.connect(self._execution.scope.cancelled)
        self._execution.run(steps, data)

    def _follow(self, work: Callable[[], None], word: str) -> None:
        """Do something in a separate thread; once cancelled, wait no longer than the grace."""

        def run_guarded() -> None:
            try:
                work()
            except BaseException as error:
                self._error = error
            finally:
                self._mail.put("ended")

        threading.Thread(target=run_guarded, daemon=True).start()
        if not self._wait_for_end():
            for name in self._execution.running or ("a provider",):
                grace = f"{self._run_context.grace:g} s"
                self._run_context.report.warn(
                    f"{name} did not {word} within {grace} and was abandoned"
                )

    def _wait_for_end(self) -> bool:
        """Wait for the current thread; False when the grace is over."""
        deadline = None
        while True:
            if deadline is None and self._execution.scope.cancelled.is_set():
                deadline = time.monotonic() + self._run_context.grace
            left = LOOK if deadline is None else max(0.0, deadline - time.monotonic())
            try:
                note = self._mail.get(timeout=min(left, LOOK))
            except queue.Empty:
                if deadline is not None and time.monotonic() >= deadline:
                    return False
                continue
            if note == "ended":
                return True
            if note == "interrupted":
                self._interrupt()

    def _interrupt(self) -> None:
        if self._interrupted:
            raise self._interruption(
                "interrupted twice: stopped without waiting", "run the same command again"
            )
        self._interrupted = True
        running = ", ".join(self._execution.running) or "no job"
        self._run_context.report.warn(f"stopping {running}; Ctrl-C again ends at once")
        self._execution.scope.cancel()

    def _raise(self) -> None:
        if self._execution.failure:
            raise self._execution.failure
        if self._interrupted or (self._execution.scope.cancelled.is_set() and not self._error):
            interruption = self._execution.interruption
            message = interruption.message if interruption else "interrupted"
            hint = interruption.hint if interruption else None
            raise self._interruption(message, hint) from self._error
        if self._error:
            raise self._error

    def _interruption(self, message: str, hint: str | None = None) -> Interrupted:
        details = [f"still running: {name}" for name in self._execution.running]
        return Interrupted(message, hint=hint, details=details)
