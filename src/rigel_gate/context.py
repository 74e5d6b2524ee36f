"""What the parts of the gate share: state, connections, log, turns, tasks.

It does not import the parts. A part gets this object and the parts that it calls, never the whole
gate.
"""

from __future__ import annotations

import asyncio
from typing import Any, Callable, Coroutine

from rigel_gate.calls import Removal
from rigel_gate.links import Links
from rigel_gate.state import Event, State


class Context:
    """One gate's own things.

    Attributes:
        state: what the gate has noted; what a later gate needs too is changed by `note` alone.
        links: the ways to the master and to nodes, and a clock.
        log: called with a line for people to read.
        turn: held while the master changes and until the state has the change too. Changes take
            turns, so that the holder finds in the state what the master has.
        removals: what nodes unregister at this moment. They have forgotten it already, and the
            master still has it.
        lapsing: what a node can unregister that is about to lose its name. It stops publishing only
            when it is answered, and its name changes hands only when it has stopped. So these calls
            do not wait for their turn. The master drops it all with the name.
    """

    def __init__(
        self,
        state: State,
        links: Links,
        keep: Callable[[Event], None],
        log: Callable[[str], None],
    ) -> None:
        self.state = state
        self.links = links
        self.log = log
        self.turn = asyncio.Lock()
        self.removals: list[Removal] = []
        self.lapsing: frozenset[Removal] = frozenset()
        self._keep = keep
        self._tasks: set[asyncio.Task[Any]] = set()
        self._looks: set[tuple[str, Callable[[str], Any]]] = set()

    def note(self, *event: Any) -> None:
        """Change the state, and keep the event for a gate that starts later."""
        self.state.apply(list(event))
        self._keep(list(event))

    def note_value(self, event: Event, value: Any, size: int) -> None:
        """Keep the event of a parameter, whose value need not be unpacked and measured."""
        self.state.set_parameter(event[1], value, size)
        self._keep(event)

    def spawn(self, work: Coroutine[Any, Any, Any]) -> None:
        """Run a coroutine in the background; a failure is logged."""
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._end)

    def spawn_once(self, name: str, look: Callable[[str], Coroutine[Any, Any, None]]) -> None:
        """Check a name, unless this check is still running: an unreachable machine takes long."""
        if (name, look) in self._looks:
            return
        self._looks.add((name, look))

        async def work() -> None:
            try:
                await look(name)
            finally:
                self._looks.discard((name, look))

        self.spawn(work())

    async def stop(self) -> None:
        """End all tasks that were started."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _end(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and task.exception():
            self.log(f"error: {task.exception()!r}")
