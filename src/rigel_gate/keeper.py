"""Keeps the state where it outlives the gate: at once in the pod's file, then in the cluster.

Both carry the state's revision. The higher one counts: the file may be on a disk that was full.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Awaitable, Callable, TypeVar

from rigel_gate.cluster import ClusterObject, NotKept, Overtaken
from rigel_gate.memory import Journal, TooLarge, compress, decompress, read_revision
from rigel_gate.state import Event, State

#: Seconds between two writes to the cluster, and between two attempts that fail: at first, at most.
PAUSE, LONGEST_PAUSE = 1.0, 60.0
#: How many times as long as a write took nothing is written after it.
REST = 4
#: How often the memory is looked for in the cluster before the gate begins without it.
TRIES = 20
#: Seconds that a gate with a file waits for the cluster's copy, which is seldom the newer one.
PATIENCE = 3.0
#: How many gates may be killed while they begin with the file: before the cluster's copy counts,
#: and before the next one begins without either.
FAILURES, GIVE_UP = 3, 10
#: Bytes that an object of the cluster may have, with room for the rest of it.
LARGEST = 700_000
#: Where the memory is kept, in words.
FILE, CLUSTER = "the file of the pod", "the cluster"

T = TypeVar("T")


class Keeper:
    """Keeps a state, and finds the one that an earlier gate has kept.

    Attributes:
        notes: what was unusual at the start, for `describe`.
    """

    def __init__(
        self,
        journal: Journal,
        place: ClusterObject | None,
        log: Callable[[str], None],
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._journal = journal
        self._place = place
        self._log = log
        self._sleep = sleep
        self._changed = asyncio.Event()
        self._due = asyncio.Event()
        self._trouble: dict[str, str] = {}
        self.notes: list[str] = []
        self.state = State()

    # -- at the start --

    async def begin(self, failures: int = 0) -> None:
        """Find what an earlier gate has left: one of this pod, or of another pod.

        Args:
            failures: how many gates were killed, one after the other, while they used the file.
        """
        is_distrusted = failures >= FAILURES
        copy = await self._read_cluster(takes_over=False) if is_distrusted else None
        found = None
        if copy is not None or failures >= GIVE_UP:
            why = f"{failures} gates were killed while they began with it"
            self.notes.append(f"the memory in {FILE} is not used: {why}")
            self._log(self.notes[-1])
        else:
            found = self._read_file()
        if found is not None:
            copy = None if is_distrusted else await self._read_newer(found.revision)
            self._changed.set()  # the cluster may not have the last of it
        elif not is_distrusted:
            copy = await self._read_cluster(takes_over=True)
        self.state = copy or found or State()
        if self.state.left_out:
            self._log(
                f"{self.state.left_out} lines of the memory cannot be read: they are left out"
            )
        self.state.parameters.count()
        if found is self.state and not found.left_out:
            try:
                self._journal.resume()
            except OSError as error:
                self._report(FILE, str(error))
        else:
            await self._write_file()
        if self._journal.is_due:
            self._due.set()

    def _read_file(self) -> State | None:
        try:
            return self._journal.read()
        except (OSError, ValueError) as error:
            self._log(f"the memory in {FILE} is not used: {error}")
        return None

    async def _read_cluster(self, *, takes_over: bool) -> State | None:
        """Return what the cluster keeps; asked for a while, since an empty gate forgets nodes."""
        for left in reversed(range(TRIES)):
            if self._place is None:
                break
            try:
                text = await in_thread(partial(self._place.read, takes_over=takes_over))
                return decompress(text) if text else None
            except NotKept as error:
                self._log(f"the memory in the cluster cannot be read: {error}")
                await self._sleep(PAUSE if left else 0)
            except ValueError as error:
                self._log(f"the memory in the cluster is not used: {error}")
                break
        return None

    async def _read_newer(self, revision: int) -> State | None:
        """Return what the cluster keeps if it is newer than this revision."""
        if self._place is None:
            return None
        asking = in_thread(partial(self._place.read, takes_over=False))
        try:
            text = await asyncio.wait_for(asking, PATIENCE) or ""
            if not text or read_revision(text) <= revision:
                return None
            self._log(f"the memory in the cluster is newer than {FILE}: it is used")
            return decompress(text)
        except asyncio.TimeoutError:
            why = f"no answer within {PATIENCE:g} s"
        except (NotKept, ValueError) as error:
            why = str(error)
        self._log(f"the memory in the cluster cannot be compared with {FILE}: {why}")
        return None

    # -- while the gate runs --

    def keep(self, event: Event) -> None:
        """Keep an event in the file, and write to the cluster later."""
        try:
            self._journal.keep(event)
        except OSError as error:
            self._report(FILE, str(error))
        if self._journal.is_due:
            self._due.set()
        self._changed.set()

    async def run(self) -> None:
        """Write what has changed to the cluster, and the file again, until the end."""
        await asyncio.gather(self._run_cluster(), self._run_file())

    async def _run_cluster(self) -> None:
        now, pause = asyncio.get_running_loop().time, PAUSE
        while self._place is not None:
            await self._changed.wait()
            began = now()
            try:
                fits = await self.save()
            except Exception as error:  # without this nothing would be written any more
                fits = True
                self._changed.set()
                self._report(CLUSTER, repr(error))
            pause = PAUSE if fits else min(2 * pause, LONGEST_PAUSE)
            await self._sleep(max(pause, REST * (now() - began)))

    async def save(self) -> bool:
        """Write the state to the cluster, if it has changed; return False if it is too large."""
        if self._place is None or not self._changed.is_set():
            return True
        self._changed.clear()
        try:
            text = await in_thread(partial(compress, self.state.events(), LARGEST))
            await in_thread(partial(self._place.write, text))
            self._report(CLUSTER, "")
        except TooLarge as error:  # the next change may make it smaller
            self._report(CLUSTER, str(error))
            return False
        except Overtaken as error:
            self._report(CLUSTER, str(error))
            self._place = None
        except NotKept as error:
            self._changed.set()
            self._report(CLUSTER, str(error))
        except asyncio.CancelledError:  # the gate ends, and saves once more
            self._changed.set()
            raise
        return True

    async def _run_file(self) -> None:
        pause = PAUSE
        while True:
            await self._due.wait()
            self._due.clear()
            if await self._write_file():
                pause = PAUSE
            else:
                await self._sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
                self._due.set()

    async def _write_file(self) -> bool:
        """Write the state to the file; return whether it has been."""
        try:
            await in_thread(partial(self._journal.write, self._journal.draft(self.state)))
            while self._journal.is_behind:
                await in_thread(partial(self._journal.catch_up, self._journal.take_tail()))
            self._journal.finish()
        except OSError as error:  # such as a full disk
            self._journal.abandon()
            if not self._journal.is_open:
                self._report(FILE, str(error))
            return False
        self._report(FILE, "")
        return True

    def list_troubles(self) -> list[str]:
        """Return where the memory is not kept, and why not."""
        found = self._trouble.items()
        return [f"the memory is not kept in {where}: {why}" for where, why in found if why]

    def _report(self, where: str, trouble: str) -> None:
        if trouble != self._trouble.get(where, ""):
            good = f"the memory is kept in {where} again"
            self._log(f"the memory is not kept in {where}: {trouble}" if trouble else good)
        self._trouble[where] = trouble


async def in_thread(work: Callable[[], T]) -> T:
    """Return what a function returns; calls are answered meanwhile."""
    return await asyncio.get_running_loop().run_in_executor(None, work)
