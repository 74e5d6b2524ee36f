"""Runs a tree of steps: threads, failures, Ctrl-C; independent of Rigelfiles and job types.

Jobs run in other threads, so that Ctrl-C reaches the main thread, which can stop them cleanly.
Every wait here ends when the job that it waits for ends, and `cancel` makes every job end; only
the main thread gives up a job that ignores it. Threads are daemonic, which those of
concurrent.futures are not: a second Ctrl-C must end the program.
"""

from __future__ import annotations

import copy
import queue
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Protocol

import attrs

from rigel_k8s.errors import Interrupted, JobFailed, RigelK8sError, UserError
from rigel_k8s.jobs.job import Exclusive, JobContext, JobOptions, JobReporter, ProviderType
from rigel_k8s.jobs.matrix import (
    Limits,
    Outcome,
    State,
    combinations,
    count_failures,
    failure,
    label,
    list_outcomes,
    split_limits,
    summarise,
)
from rigel_k8s.jobs.steps import Branches, Job, Jobs, Serving, Step
from rigel_k8s.jobs.stopping import CancelScope, interruptions

#: Seconds that jobs may take to end after Ctrl-C or another job's failure.
GRACE = 30.0
#: Seconds that a dependency may take to become ready, unless --timeout is set.
READY_TIMEOUT = 300.0
#: Seconds that Python sleeps at most: a signal just before that is handled when it wakes up.
LOOK = 0.5


class Reader(Protocol):
    """What the Rigelfile says, now that the data of earlier jobs is available."""

    def realise(self, job: Job, data: Mapping[str, Any]) -> JobOptions:
        """Return a job's options, checked. Raises UserErrors."""

    def matrix(self, step: Branches, data: Mapping[str, Any]) -> Mapping[str, list[Any]]:
        """Return a matrix as {key: values}. Raises UserErrors."""


@attrs.frozen
class Declared:
    """A provider of the Rigelfile with its options, not connected."""

    name: str
    type: ProviderType[Any]
    options: Any


def run_steps(
    steps: Jobs,
    context: JobContext,
    reader: Reader,
    declared: Sequence[Declared] = (),
    *,
    scope: CancelScope | None = None,
    grace: float = GRACE,
) -> None:
    """Run steps to their end; jobs store in the context's data.

    Args:
        steps: what to do.
        context: what all jobs have in common; its providers are already connected.
        reader: makes options and matrices.
        declared: the providers to connect before and to disconnect after.
        scope: what stops the run from outside.
        grace: seconds that a job may take to end after it was cancelled.

    Raises:
        JobFailed: the first failure; all other jobs were stopped.
        RigelK8sError: a provider could not connect; the error names it.
        Interrupted: Ctrl-C or SIGTERM; jobs were cancelled and waited for, `grace` seconds at
            most, or not at all after a second one.
    """
    connections = dict(context.providers)
    run = attrs.evolve(context, providers=connections)
    providers = _Providers(declared, connections, context.report)
    _Engine(run, reader, scope or CancelScope(), grace).run(steps, providers)


class _Stopped(Exception):
    """Unwinds a thread after the run was cancelled; the reason is with what cancelled it."""


class _Boundary:
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
class _Branch:
    """Where a step runs: its name ("" is the trunk), its own data, its reporter, what stops it."""

    name: str
    data: MutableMapping[str, Any]
    report: JobReporter
    scope: CancelScope
    boundary: _Boundary

    def describe(self, what: str) -> str:
        """Return a text that names something of this branch."""
        return f"{what} ({self.name})" if self.name else what

    def part(self, combination: Mapping[str, Any]) -> _Branch:
        """Return a branch for one combination: a copy of the data, and the combination in it."""
        data = {**copy.deepcopy(self.data), **copy.deepcopy(dict(combination))}
        if not combination:
            return attrs.evolve(self, data=data, scope=self.scope.part())
        name = label(combination)
        full = f"{self.name}, {name}" if self.name else name
        return _Branch(full, data, self.report.child(name), self.scope.part(), self.boundary)


class _Engine:
    """One run, stopped by its scope."""

    def __init__(
        self, context: JobContext, reader: Reader, scope: CancelScope, grace: float
    ) -> None:
        self._context = context
        self._reader = reader
        self._scope = scope
        self._grace = grace
        self._lock = threading.Lock()
        self._interrupted = False
        self._running: list[str] = []
        self._held: dict[str, str] = {}  # by key: the job that uses it exclusively
        self._interruption: Interrupted | None = None  # of the first job that was
        self._mail: queue.SimpleQueue[object] = queue.SimpleQueue()  # to the main thread

    # The main thread

    def run(self, steps: Jobs, providers: _Providers) -> None:
        """Connect, work, disconnect, and raise what ended it."""
        scope = self._scope
        boundary = _Boundary(scope)
        trunk = _Branch("", self._context.data, self._context.report, scope, boundary)

        def work() -> None:
            providers.connect(scope.cancelled)
            self._guard(partial(self._run_step, steps, trunk), trunk)

        scope.on_cancel(lambda: self._mail.put("cancelled"))
        with interruptions(lambda: self._mail.put("interrupted")):
            errors = [self._follow(work, "stop"), self._follow(providers.disconnect, "disconnect")]
        error = next(filter(None, errors), None)
        if boundary.failure:
            raise boundary.failure
        if self._interrupted or (scope.cancelled.is_set() and not error):
            left = self._interruption or Interrupted("interrupted")
            raise self._make_interrupted(left.message, left.hint) from error
        if error:
            raise error

    def _follow(self, work: Callable[[], None], word: str) -> BaseException | None:
        """Work in another thread; once cancelled, wait no longer than the grace.

        Returns:
            What the work raised.
        """
        errors: list[BaseException] = []

        def run() -> None:
            try:
                work()
            except BaseException as error:
                errors.append(error)
            finally:
                self._mail.put(work)

        threading.Thread(target=run, daemon=True).start()
        deadline = None
        while True:
            if deadline is None and self._scope.cancelled.is_set():
                deadline = time.monotonic() + self._grace
            left = LOOK if deadline is None else max(0.0, deadline - time.monotonic())
            try:
                note = self._mail.get(timeout=min(left, LOOK))
            except queue.Empty:
                if deadline is None or time.monotonic() < deadline:
                    continue
                for name in self._list_running() or ("a provider",):
                    self._context.report.warn(
                        f"{name} did not {word} within {self._grace:g} s and was abandoned"
                    )
                return next(iter(errors), None)
            if note is work:
                return next(iter(errors), None)
            if note == "interrupted":
                self._interrupt()

    def _interrupt(self) -> None:
        if self._interrupted:
            raise self._make_interrupted(
                "interrupted twice: stopped without waiting", "run the same command again"
            )
        self._interrupted = True
        running = ", ".join(self._list_running()) or "no job"
        self._context.report.warn(f"stopping {running}; Ctrl-C again ends at once")
        self._scope.cancel()

    def _make_interrupted(self, message: str, hint: str | None) -> Interrupted:
        details = [f"still running: {name}" for name in self._list_running()]
        return Interrupted(message, hint=hint, details=details)

    def _list_running(self) -> tuple[str, ...]:
        with self._lock:
            return tuple(self._running)

    # Steps

    def _run_step(self, step: Step, branch: _Branch) -> None:
        if branch.scope.cancelled.is_set():
            raise _Stopped
        if isinstance(step, Job):
            self._run_job(step, branch)
        elif isinstance(step, Jobs):
            for inner in step.steps:
                self._run_step(inner, branch)
        elif isinstance(step, Serving):
            self._run_serving(step, branch)
        else:
            self._run_branches(step, branch)

    def _run_branches(self, step: Branches, branch: _Branch) -> None:
        with self._note_failure(branch.describe("the matrix of a parallel stage"), branch):
            matrix, limits = split_limits(self._reader.matrix(step, branch.data))
            parts = [branch.part(combination) for combination in combinations(matrix)]
            if not parts:
                branch.report.warn("the matrix has no combinations: its stages do not run")
        if limits is None:
            self._run_side_by_side(step.body, parts)
        else:
            self._run_waves(step.body, parts, limits, branch)
        if branch.scope.cancelled.is_set():
            raise _Stopped

    def _run_side_by_side(self, body: Step, parts: Sequence[_Branch]) -> Mapping[_Branch, State]:
        """Run branches to their end; return how each ended, apart from its failure."""
        states: dict[_Branch, State] = dict.fromkeys(parts, "not begun")

        def run(part: _Branch) -> None:
            if not part.scope.cancelled.is_set():
                states[part] = "stopped"
                self._run_step(body, part)
                if not part.scope.cancelled.is_set():
                    states[part] = "done"

        threads = [self._start_thread(partial(run, part), part) for part in parts]
        for thread in threads:
            thread.join()
        return states

    def _run_waves(
        self, body: Step, parts: Sequence[_Branch], limits: Limits, branch: _Branch
    ) -> None:
        """Run one wave after the other; a branch that fails stops no other one of its wave."""
        outcomes: list[Outcome] = []
        waves = limits.waves(parts)
        for number, wave in enumerate(waves, 1):
            if branch.scope.cancelled.is_set() or count_failures(outcomes) >= limits.stop_after:
                outcomes += [Outcome(part.name, "not begun") for part in wave]
                continue
            names = "; ".join(part.name for part in wave)
            branch.report.line(f"wave {number} of {len(waves)}: {names}")
            own = [attrs.evolve(part, boundary=_Boundary(part.scope)) for part in wave]
            for part, state in self._run_side_by_side(body, own).items():
                failed = part.boundary.failure
                outcomes.append(Outcome(part.name, "failed" if failed else state, failed))
        if branch.scope.cancelled.is_set():
            branch.report.warn("\n".join([summarise(outcomes), *list_outcomes(outcomes)]))
        elif count_failures(outcomes):
            branch.boundary.take(failure(outcomes))
        else:
            branch.report.line(summarise(outcomes))

    def _run_serving(self, step: Serving, branch: _Branch) -> None:
        scope = branch.scope.part()
        servers: list[tuple[str, threading.Thread]] = []
        try:
            for job in step.dependencies:
                thread = self._start_server(job, attrs.evolve(branch, scope=scope))
                servers.append((f"dependency {job.name}", thread))
            self._run_step(step.jobs, branch)
        finally:
            scope.cancel()
            for where, thread in servers:
                thread.join(self._grace)
                if thread.is_alive():
                    late = RigelK8sError(f"it did not stop within {self._grace:g} s")
                    self._fail(where, late, branch)
        if branch.scope.cancelled.is_set():
            raise _Stopped

    def _start_server(self, job: Job, branch: _Branch) -> threading.Thread:
        """Start a dependency; returns when it is ready, or has ended."""
        ready = threading.Event()

        def serve() -> None:
            try:
                self._run_job(job, branch, ready)
            finally:
                ready.set()

        thread = self._start_thread(serve, branch)
        timeout = self._context.settings.timeout or READY_TIMEOUT
        if not ready.wait(timeout):
            late = RigelK8sError(
                f"it was neither ready nor finished after {timeout:g} s",
                hint="a job that serves others sets `job.ready`; give it more time with --timeout",
            )
            self._fail(f"dependency {job.name}", late, branch)
            raise _Stopped
        return thread

    def _run_job(self, job: Job, branch: _Branch, ready: threading.Event | None = None) -> None:
        where = branch.describe(f"job {job.name}")
        report, scope = branch.report, branch.scope.part()
        try:
            with self._note_failure(where, branch), self._note_running(where):
                report.progress(job.name, "running")
                made = self._reader.realise(job, branch.data)
                context = attrs.evolve(
                    self._context,
                    name=job.name,
                    report=report.child(job.name),
                    data=branch.data,
                    cancel=scope.cancelled,
                    raw=made.raw,
                    serving=ready is not None,
                    ready=ready or threading.Event(),
                    place=made.place,
                )
                with self._hold(job, made.options, where):
                    job.type.run(made.options, context)
        except _Stopped as end:
            failed = end.__cause__ and not isinstance(end.__cause__, Interrupted)
            report.progress(job.name, "failed" if failed else "stopped")
            raise
        finally:
            scope.cancel()
        stopped = branch.scope.cancelled.is_set()
        report.progress(job.name, "stopped" if stopped else "done", done=not stopped)

    @contextmanager
    def _note_running(self, where: str) -> Iterator[None]:
        with self._lock:
            self._running.append(where)
        try:
            yield
        finally:
            with self._lock:
                self._running.remove(where)

    @contextmanager
    def _hold(self, job: Job, options: Any, where: str) -> Iterator[None]:
        """Hold what a job uses exclusively (such as a release); UserError if another one does."""
        run, key = self._context, None
        if isinstance(job.type, Exclusive):
            key = job.type.exclusive(options, run.application, run.settings)
        if key is None:
            yield
            return
        with self._lock:
            other = self._held.get(key)
            self._held.setdefault(key, where)
        if other is not None:
            raise UserError(
                f"{other} works on {key} at the same time",
                hint="run them one after the other, or give them different names",
            )
        try:
            yield
        finally:
            with self._lock:
                del self._held[key]

    # Failures

    def _start_thread(self, work: Callable[[], None], branch: _Branch) -> threading.Thread:
        thread = threading.Thread(target=self._guard, args=(work, branch), daemon=True)
        thread.start()
        return thread

    def _guard(self, work: Callable[[], None], branch: _Branch) -> None:
        """Do a thread's work; what no job caused is a failure of the sequence."""
        with suppress(_Stopped), self._note_failure(branch.describe("the sequence"), branch):
            work()

    @contextmanager
    def _note_failure(self, where: str, branch: _Branch) -> Iterator[None]:
        """Note a failure, stop everything, unwind; after a cancellation it is only reported."""
        try:
            yield
        except _Stopped:
            raise
        except BaseException as error:
            if not (isinstance(error, Interrupted) and branch.scope.cancelled.is_set()):
                self._fail(where, error, branch)
            elif isinstance(error, Interrupted) and self._interruption is None:
                self._interruption = error
            raise _Stopped from error

    def _fail(self, where: str, error: BaseException, branch: _Branch) -> None:
        if not branch.boundary.take(make_failure(where, error)):
            branch.report.warn(f"{where}, while it was stopped: {summarise_error(error)}")


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


def summarise_error(error: BaseException) -> str:
    """Return an error in one line."""
    return error.message if isinstance(error, RigelK8sError) else f"{type(error).__name__}: {error}"


class _Providers:
    """Connections by the providers' names; `disconnect` may be called at any time, and twice."""

    def __init__(
        self, declared: Sequence[Declared], connections: dict[str, Any], report: JobReporter
    ) -> None:
        self._declared = declared
        self._connections = connections
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
                kind = UserError if isinstance(error, UserError) else RigelK8sError
                message = f"provider {declared.name} could not connect: {error.message}"
                raise kind(message, hint=error.hint, details=error.details) from error
            with self._lock:
                closed = self._closed
                if not closed:
                    self._connections[declared.name] = connection
                    self._open.append(declared)
            if closed:  # the run was given up meanwhile
                declared.type.disconnect(connection)

    def disconnect(self) -> None:
        """Disconnect all in reverse order; an error is reported and does not stop the others."""
        with self._lock:
            self._closed = True
            ending, self._open = self._open[::-1], []
        for declared in ending:
            try:
                declared.type.disconnect(self._connections[declared.name])
            except Exception as error:
                self._report.warn(f"provider {declared.name} did not disconnect: {error}")
