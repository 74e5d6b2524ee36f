"""The way to the master: calls wait while it is down, and while a name changes hands.

Others decide what a returning master must be given, and what an earlier gate has left unfinished.
They are called when it is time.
"""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from typing import AsyncIterator, Awaitable, Callable

from rigel_gate.calls import GATE, Answer, Call
from rigel_gate.context import Context
from rigel_gate.links import MasterGone

#: Seconds between two attempts to reach a master that is down.
RETRY = 0.05


class Master:
    """roscore, as the other parts of the gate see it: it always answers, perhaps later.

    Attributes:
        trouble: why calls wait although a master answers, "" if they do not.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._ready = asyncio.Event()
        self._away = False  # whether the last attempt to reach it failed
        self.trouble = ""
        self._started = False
        self._open = asyncio.Event()  # set while no name changes hands
        self._asking = 0
        self._idle = asyncio.Event()  # set while no call that changes nothing is in progress
        self._idle.set()
        self._complete: Callable[[], Awaitable[None]]
        self._finish: Callable[[], Awaitable[None]]

    def start(
        self, complete: Callable[[], Awaitable[None]], finish: Callable[[], Awaitable[None]]
    ) -> None:
        """Look for the master until stopped.

        Args:
            complete: called for each master that answers, before any other call reaches it; may
                raise MasterGone.
            finish: called once, when the first master is complete; calls that change nothing wait
                for its end.
        """
        self._complete = complete
        self._finish = finish
        self._context.spawn(self._recover())
        self._context.spawn(self._watch())

    @property
    def is_ready(self) -> bool:
        """Whether the master answers and has all registrations, as far as the gate can see."""
        return self._ready.is_set()

    @property
    def has_started(self) -> bool:
        """Whether this gate has had a complete master, and has finished an earlier gate's work."""
        return self._started

    async def until_ready(self) -> None:
        """Return when the master answers and has all registrations."""
        await self._ready.wait()

    async def is_there(self) -> bool:
        """Return whether a master is there; it may be even if a connection has ended."""
        while not self._ready.is_set() and not self._away:
            await self._context.links.sleep(RETRY)
        return self._ready.is_set()

    async def call(self, call: Call, settle: Callable[[], Awaitable[None]] | None = None) -> Answer:
        """Pass a call on as soon as the master answers and has all registrations.

        Args:
            settle: awaited just before each attempt. When a master returns, the gate sends things
                to nodes, and a call that changes these things must not overtake them.
        """
        while True:
            await self._ready.wait()
            if settle is not None:
                await settle()
            try:
                return await self._context.links.master(call)
            except MasterGone as error:
                self._lose(str(error))

    async def ask(self, call: Call) -> Answer:
        """Pass a call on that changes nothing: before a hand-over or after it, never during one."""
        while not self._open.is_set():
            await self._open.wait()
        self._asking += 1
        self._idle.clear()
        try:
            return await self.call(call)
        finally:
            self._asking -= 1
            if not self._asking:
                self._idle.set()

    @asynccontextmanager
    async def handing_over(self) -> AsyncIterator[None]:
        """Let no `ask` see a half-done change; begins when the calls in progress are answered."""
        self._open.clear()
        try:
            await self._idle.wait()
            yield
        finally:
            if self._started:
                self._open.set()

    # -- a master that ends, and one that starts --

    def _lose(self, reason: str) -> None:
        """Let calls wait until it is clear which master is there."""
        if self._ready.is_set():
            self._ready.clear()
            self._context.spawn(self._find(reason))

    async def _find(self, reason: str) -> None:
        if await self._is_same():
            self._ready.set()
            return
        self._context.log(f"the master is unreachable: {reason}")
        await self._recover()

    async def _watch(self) -> None:
        """Notice the master's end at once, not with the next call."""
        while True:
            await self._ready.wait()
            await self._context.links.until_master_hangs_up()
            self._lose("closed by the master")
            await self._context.links.sleep(RETRY)

    async def _is_same(self) -> bool:
        """Return whether the master is still there and is the one of the state.

        roscore ends connections that are idle for as long as its `-t` says.
        """
        try:
            run = (await self._context.links.master(Call("getParam", (GATE, "/run_id")))).result
        except Exception:  # whatever the cause, _recover meets it again and reports it
            return False
        return bool(run) and str(run) == self._context.state.run

    async def _recover(self) -> None:
        """Wait for a master, and until it has been given all that it is missing."""
        while True:
            try:
                await self._complete()
                break
            except MasterGone:
                self._away = True
                await self._context.links.sleep(RETRY)
            except Exception as error:  # without this the gate would wait for the master forever
                self.trouble = f"the new master cannot be given its registrations: {error!r}"
                self._context.log(f"error: {self.trouble}")
                await self._context.links.sleep(1)
        self._away, self.trouble = False, ""
        self._ready.set()
        if not self._started:
            try:
                await self._finish()
            finally:
                self._started = True
                self._open.set()
