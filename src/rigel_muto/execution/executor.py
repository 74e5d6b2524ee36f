"""Executes commands of Muto: one at a time, and the last one wins.

A command is checked, stored, and then deployed in the background. The stored record describes what
must run: an agent that restarts continues what the previous one has not finished.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as OutOfTime
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, Interrupted, ProblemsError, RigelK8sError, RolloutFailed
from rigel_k8s.jobs.runner import Prepared
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.kube.failures import Forbidden, Missing
from rigel_muto.agent.allowance import Allowance
from rigel_muto.agent.commands import (
    Command,
    ComponentState,
    Kill,
    Outcome,
    Query,
    Stage,
    Unavailable,
)
from rigel_muto.agent.memory import Memory
from rigel_muto.agent.turns import Turns
from rigel_muto.agent.wanted import Record, State, Wanted, apply_command
from rigel_muto.execution.target import DeployedJob

#: Seconds that a sender waits for the objects to be stored, or for an early failure. Symphony gives
#: 8 s for all of an answer.
PATIENCE = 3.0
#: Seconds for an answer about the ROS graph.
ANSWER = 7.0
#: Seconds between two checks whether what must run is still ready.
LOOK = 10.0
#: Seconds that a deploy may take to end when the agent ends.
GRACE = 20.0
#: Lines of an error that senders get.
MOST_DETAILS = 5

SUPERSEDED = Outcome(Stage.SUPERSEDED, "a newer command has replaced this one")


class ReleaseExecutor:
    """Executes commands on one release.

    Args:
        announce: is called with the record whenever it changes.
    """

    def __init__(
        self,
        application: DeployedJob,
        memory: Memory,
        allowance: Allowance,
        announce: Callable[[Record], None],
    ) -> None:
        self._application = application
        self._memory = memory
        self._allowance = allowance
        self._announce = announce
        self.report = application.report
        self._lock = threading.Lock()
        self._turns = Turns(self._look_again, LOOK)
        self.record = memory.load()

    def start(self) -> None:
        """Start, with what a previous agent has not finished."""
        self._announce(self.record)
        if self.record.is_open:
            self.report.line("continuing the last command")
            self._turns.put(_Task(self, self.record))
        self._turns.start()

    def close(self) -> None:
        """End soon; the next agent finishes a command that is being executed."""
        self._turns.close(GRACE)

    def submit(self, command: Command) -> Outcome:
        """Store a command and start it; return when its objects are stored, or it failed.

        Raises:
            Unavailable: the cluster cannot be reached, so the command is not stored.
        """
        if command.identity and command.identity in self.record.identities:
            return self._describe_duplicate(command.identity)
        wanted = apply_command(command, self.record.wanted)
        if wanted == self.record.wanted and not wanted.is_nothing:
            if isinstance(command, Kill):
                return Outcome(Stage.DONE, "it does not run: nothing has changed")
            if wanted.text is not None and self.record.is_open:  # Symphony sends it until it runs
                return describe_record(self.record)
        try:
            prepared = None if wanted.is_nothing else self._check(wanted)
            accepted = self.record.accept(wanted, command.identity)
            self._accept(accepted)
        except RigelK8sError as error:
            if isinstance(error, ClusterError) and not isinstance(error, Forbidden | Missing):
                raise Unavailable(f"cannot store the command: {error.message}") from error
            return Outcome(Stage.REFUSED, describe(error))
        task = _Task(self, accepted, prepared)
        self._turns.put(task)
        return task.wait(PATIENCE)

    def look(self, components: tuple[str, ...]) -> Mapping[str, ComponentState]:
        """Return the states of components; all are ready if the release is."""
        record = self.record
        there = record.wanted.components
        ready = record.state == "active"
        return {
            name: ComponentState(there[name], ready, record.cause)
            for name in components
            if name in there
        }

    def ask(self, query: Query) -> Any:
        """Return the answer to a question.

        Raises:
            RigelK8sError: there is no answer, or not in time.
        """
        if query.kind == "ping":
            return dict(query.arguments)
        beside = ThreadPoolExecutor(max_workers=1)
        try:
            asked = beside.submit(self._application.answer, query)
            return asked.result(timeout=ANSWER)
        except OutOfTime as error:
            raise RigelK8sError(f"{query.kind} was not answered within {ANSWER:g} s") from error
        finally:
            beside.shutdown(wait=False)

    def _check(self, wanted: Wanted) -> Prepared:
        """Return a stack as a job that can run. Raises as DeployedJob.prepare, or UserError."""
        self._allowance.check_stack(wanted)
        prepared, images = self._application.prepare(wanted)
        self._allowance.check_images(images)
        return prepared

    def _describe_duplicate(self, identity: str) -> Outcome:
        record = self.record
        return describe_record(record) if record.identity == identity else SUPERSEDED

    def _accept(self, record: Record) -> None:
        """Store a new command. Raises as Memory.store."""
        with self._lock:
            self._memory.store(record)
            self.record = record
            self._publish(record)

    def carry_out(self, task: _Task) -> Record:
        """Deploy or remove; return the record with the result.

        Raises:
            RigelK8sError: it failed.
        """
        record = task.record
        if record.wanted.is_nothing:
            self._application.remove(task.scope.cancelled)
            return attrs.evolve(record, state="killed")
        prepared = task.prepared or self._check(record.wanted)
        self._application.deploy(prepared, task.scope, task.applied)
        return attrs.evolve(record, state="active", is_there=True)

    def finish(self, record: Record) -> None:
        """Store and announce the result of a command, unless there is a newer one."""
        with self._lock:
            before = self.record
            if before.number != record.number:
                return
            try:
                self._memory.store(record)
            except RigelK8sError as error:  # after a restart it is determined again
                self.report.warn(f"cannot store the agent's record: {error.message}")
            self.record = record
            if (record.state, record.cause) != (before.state, before.cause):
                self._publish(record)

    def _publish(self, record: Record) -> None:
        self._announce(record)
        cause = f": {record.cause}" if record.cause else ""
        self.report.line(f"{record.label or 'the stack'} is {record.state}{cause}")

    def _look_again(self) -> None:
        """Check whether what was deployed still runs and is ready, and announce changes."""
        record = self.record
        if not record.is_there:
            return
        try:
            revision, faults = self._application.look()
        except RigelK8sError:
            return  # an unreachable cluster is not a change
        is_foreign = revision != 0 and record.revision not in (0, revision)
        if is_foreign:
            faults = [f"revision {revision} of the release is not from this command"]
        state: State = "failed" if faults else "active"
        changed = attrs.evolve(record, state=state, revision=record.revision or revision)
        if is_foreign or state != record.state:  # else the first cause says more than later ones
            changed = attrs.evolve(changed, cause="; ".join(faults))
        if changed != record:
            self.finish(changed)


class _Task:
    """One command that is executed, and what its sender waits for."""

    def __init__(
        self, executor: ReleaseExecutor, record: Record, prepared: Prepared | None = None
    ) -> None:
        self.record = record
        self.prepared = prepared
        self.scope = CancelScope()
        self.applied = threading.Event()
        self._executor = executor
        self._ended: Record | None = None

    def run(self) -> None:
        """Execute it, and store the result."""
        try:
            self._ended = self._executor.carry_out(self)
        except Interrupted:
            return  # a newer command waits, or the agent ends: the record stays open
        except RigelK8sError as error:
            late = isinstance(error.__cause__, RolloutFailed)
            self._ended = self._fail(describe(error), is_there=late)
        except Exception as error:
            self._executor.report.warn(traceback.format_exc())
            self._ended = self._fail(f"{type(error).__name__}: {error}", is_there=False)
        finally:
            self.applied.set()
        self._executor.finish(self._ended)

    def _fail(self, cause: str, *, is_there: bool) -> Record:
        return attrs.evolve(self.record, state="failed", cause=cause, is_there=is_there)

    def stop(self) -> None:
        """End soon; a sender that still waits is answered now."""
        self.scope.cancel()
        self.applied.set()

    def wait(self, patience: float) -> Outcome:
        """Return what is known when the objects are stored, or after some seconds."""
        self.applied.wait(patience)
        ended = self._ended
        return describe_record(ended if ended is not None else self.record)


def describe_record(record: Record) -> Outcome:
    """Return the answer to a command's sender."""
    if record.state == "failed":
        return Outcome(Stage.FAILED, record.cause)
    if record.is_open:
        return Outcome(Stage.ACCEPTED, "stored")
    return Outcome(Stage.DONE, record.state)


def describe(error: RigelK8sError) -> str:
    """Return an error as one text for the sender."""
    if isinstance(error, ProblemsError):  # without the lines of the file and their marks
        return "; ".join(text.splitlines()[0] for text in error.details[:MOST_DETAILS])
    lines = [line.strip() for text in error.details for line in text.splitlines()]
    causes = {line: line.partition(": ")[2] or line for line in lines}
    details = [line for line, cause in causes.items() if cause not in error.message]
    return "; ".join([error.message, *details[:MOST_DETAILS], *filter(None, [error.hint])])
