"""Runs a tree of steps: threads, failures, cancellation; independent of Rigelfiles.

Every wait here ends when the job that it waits for ends, and `cancel` makes every job end. How
long a job that ignores it may take is bounded by the wait for the whole run (runner.py).
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import attrs

from rigel_k8s.errors import Interrupted, JobFailed, RigelK8sError, UserError
from rigel_k8s.jobs.branches import (
    Boundary,
    Branch,
    CancelScope,
    Stopped,
    describe,
    make_failure,
    summarise_error,
)
from rigel_k8s.jobs.job import Exclusive, JobContext, JobOptions, JobReporter
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
from rigel_k8s.settings import Application, Settings

#: Seconds that a dependency may take to become ready, unless --timeout is set.
READY_TIMEOUT = 300.0


@attrs.frozen
class RunContext:
    """What a run needs from outside.

    Attributes:
        realise: a job and the shared data to its options, checked; raises UserErrors.
        matrix: a Branches' matrix and the shared data to {key: values}; raises UserErrors.
        grace: seconds that a job may take to end after it was cancelled.
        applied: set when a job that deploys has stored its objects.
    """

    application: Application
    settings: Settings
    report: JobReporter
    realise: Callable[[Job, Mapping[str, Any]], JobOptions]
    matrix: Callable[[Branches, Mapping[str, Any]], Mapping[str, list[Any]]]
    vars: Mapping[str, Any] = attrs.field(factory=dict)
    providers: Mapping[str, Any] = attrs.field(factory=dict)
    grace: float = 30.0
    applied: threading.Event = attrs.field(factory=threading.Event)


class Execution:
    """One run, stopped by its scope.

    `interruption` is the message of the first interrupted job about the state that it left.
    """

    def __init__(self, run: RunContext, scope: CancelScope) -> None:
        self.scope = scope
        self.interruption: Interrupted | None = None
        self._boundary = Boundary(scope)
        self._run_context = run
        self._lock = threading.Lock()
        self._running: list[str] = []
        self._held: dict[str, str] = {}  # by key: the job that uses it exclusively

    @property
    def failure(self) -> JobFailed | None:
        """The first job's failure; it has cancelled the scope."""
        return self._boundary.failure

    @property
    def running(self) -> tuple[str, ...]:
        """The jobs that run at the moment."""
        with self._lock:
            return tuple(self._running)

    def run(self, steps: Jobs, data: dict[str, Any]) -> None:
        """Run all steps; returns when all have ended, and leaves a failure in `failure`."""
        trunk = Branch("", data, self._run_context.report, self.scope, self._boundary)
        self._start_thread(partial(self._run_step, steps, trunk), trunk).join()

    def _run_step(self, step: Step, branch: Branch) -> None:
        if branch.scope.cancelled.is_set():
            raise Stopped
        if isinstance(step, Job):
            self._run_job(step, branch)
        elif isinstance(step, Jobs):
            for inner in step.steps:
                self._run_step(inner, branch)
        elif isinstance(step, Serving):
            self._run_serving(step, branch)
        else:
            self._run_branches(step, branch)

    # Branches

    def _run_branches(self, step: Branches, branch: Branch) -> None:
        parts, limits = self._parts(step, branch)
        if limits is None:
            self._run_side_by_side(step.body, parts)
        else:
            self._run_waves(step.body, parts, limits, branch)
        if branch.scope.cancelled.is_set():
            raise Stopped

    def _run_side_by_side(self, body: Step, parts: Sequence[Branch]) -> Mapping[Branch, State]:
        """Run branches to their end; return how each ended, apart from its failure."""
        states: dict[Branch, State] = dict.fromkeys(parts, "not begun")

        def run(part: Branch) -> None:
            if not part.scope.cancelled.is_set():
                states[part] = "stopped"
                self._run_step(body, part)
                if not part.scope.cancelled.is_set():
                    states[part] = "done"

        tasks = [self._start_thread(partial(run, part), part) for part in parts]
        for task in tasks:
            task.join()
        return states

    def _run_waves(
        self, body: Step, parts: Sequence[Branch], limits: Limits, branch: Branch
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
            own = [attrs.evolve(part, boundary=Boundary(part.scope)) for part in wave]
            states = self._run_side_by_side(body, own)
            outcomes += (_find_outcome(part, state) for part, state in states.items())
        if branch.scope.cancelled.is_set():
            branch.report.warn("\n".join([summarise(outcomes), *list_outcomes(outcomes)]))
        elif count_failures(outcomes):
            branch.boundary.take(failure(outcomes))
        else:
            branch.report.line(summarise(outcomes))

    def _parts(self, step: Branches, branch: Branch) -> tuple[list[Branch], Limits | None]:
        """Return a branch for each combination: a copy of the data, and the combination in it."""
        with self._note_failure(f"the matrix of a parallel stage{describe(branch)}", branch):
            matrix, limits = split_limits(self._run_context.matrix(step, branch.data))
            chosen = combinations(matrix)
            if not chosen:
                branch.report.warn("the matrix has no combinations: its stages do not run")
            return [self._part(branch, combination) for combination in chosen], limits

    def _part(self, branch: Branch, combination: Mapping[str, Any]) -> Branch:
        data = {**copy.deepcopy(branch.data), **copy.deepcopy(dict(combination))}
        if not combination:
            return attrs.evolve(branch, data=data, scope=branch.scope.part())
        name = label(combination)
        full = f"{branch.name}, {name}" if branch.name else name
        report, scope = branch.report.child(name), branch.scope.part()
        return Branch(full, data, report, scope, branch.boundary)

    # Dependencies

    def _run_serving(self, step: Serving, branch: Branch) -> None:
        scope = branch.scope.part()
        servers: list[tuple[Job, threading.Thread]] = []
        try:
            for job in step.dependencies:
                servers.append((job, self._start_server(job, attrs.evolve(branch, scope=scope))))
            self._run_step(step.jobs, branch)
        finally:
            scope.cancel()
            self._end(servers, branch)
        if branch.scope.cancelled.is_set():
            raise Stopped

    def _start_server(self, job: Job, branch: Branch) -> threading.Thread:
        """Start a dependency; returns when it is ready, or has ended."""
        ready = threading.Event()

        def serve() -> None:
            try:
                self._run_job(job, branch, ready)
            finally:
                ready.set()

        thread = self._start_thread(serve, branch)
        timeout = self._run_context.settings.timeout or READY_TIMEOUT
        if not ready.wait(timeout):
            late = RigelK8sError(
                f"it was neither ready nor finished after {timeout:g} s",
                hint="a job that serves others sets `job.ready`; give it more time with --timeout",
            )
            self._fail(f"dependency {job.name}", late, branch)
            raise Stopped
        return thread

    def _end(self, servers: list[tuple[Job, threading.Thread]], branch: Branch) -> None:
        """Wait for dependencies that were cancelled."""
        for job, thread in servers:
            thread.join(self._run_context.grace)
            if thread.is_alive():
                error = RigelK8sError(f"it did not stop within {self._run_context.grace:g} s")
                self._fail(f"dependency {job.name}", error, branch)

    # Jobs

    def _run_job(self, job: Job, branch: Branch, ready: threading.Event | None = None) -> None:
        where = f"job {job.name}{describe(branch)}"
        scope = branch.scope.part()
        try:
            with self._note_failure(where, branch), self._list_running(where):
                branch.report.progress(job.name, "running")
                self._work(job, branch, scope, where, ready)
        except Stopped as end:
            failed = end.__cause__ and not isinstance(end.__cause__, Interrupted)
            branch.report.progress(job.name, "failed" if failed else "stopped")
            raise
        finally:
            scope.cancel()
        stopped = branch.scope.cancelled.is_set()
        branch.report.progress(job.name, "stopped" if stopped else "done", done=not stopped)

    def _work(
        self,
        job: Job,
        branch: Branch,
        scope: CancelScope,
        where: str,
        ready: threading.Event | None,
    ) -> None:
        run = self._run_context
        made = run.realise(job, branch.data)
        context = JobContext(
            name=job.name,
            application=run.application,
            report=branch.report.child(job.name),
            settings=run.settings,
            data=branch.data,
            vars=run.vars,
            providers=run.providers,
            cancel=scope.cancelled,
            raw=made.raw,
            serving=ready is not None,
            ready=ready or threading.Event(),
            applied=run.applied,
            place=made.place,
        )
        with self._hold(job, made.options, where):
            job.type.run(made.options, context)

    @contextmanager
    def _hold(self, job: Job, options: Any, where: str) -> Iterator[None]:
        """Hold what a job uses exclusively (such as a release); UserError if another one does."""
        run, key = self._run_context, None
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

    @contextmanager
    def _list_running(self, where: str) -> Iterator[None]:
        with self._lock:
            self._running.append(where)
        try:
            yield
        finally:
            with self._lock:
                self._running.remove(where)

    # Failures

    @contextmanager
    def _note_failure(self, where: str, branch: Branch) -> Iterator[None]:
        """Note a failure, stop everything, unwind; after a cancellation it is only reported."""
        try:
            yield
        except Stopped:
            raise
        except BaseException as error:
            if not (isinstance(error, Interrupted) and branch.scope.cancelled.is_set()):
                self._fail(where, error, branch)
            elif isinstance(error, Interrupted) and self.interruption is None:
                self.interruption = error
            raise Stopped from error

    def _fail(self, where: str, error: BaseException, branch: Branch) -> None:
        if not branch.boundary.take(make_failure(where, error)):
            branch.report.warn(f"{where}, while it was stopped: {summarise_error(error)}")

    def _start_thread(self, work: Callable[[], None], branch: Branch) -> threading.Thread:
        """Start a thread; daemonic, since a second Ctrl-C must end the program."""

        def run_guarded() -> None:
            try:
                work()
            except Stopped:
                return
            except BaseException as error:
                self._fail(f"the sequence{describe(branch)}", error, branch)

        thread = threading.Thread(target=run_guarded, daemon=True)
        thread.start()
        return thread


def _find_outcome(part: Branch, state: State) -> Outcome:
    """Return the outcome of a branch of a wave that has ended."""
    failed = part.boundary.failure
    return Outcome(part.name, "failed" if failed else state, failed)
