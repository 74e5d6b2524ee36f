"""The way to nodes: whether they are there, and what the gate sends them.

The master sends changes to its own nodes. The gate sends the same two calls, `publisherUpdate` and
`paramUpdate`, to nodes that the master does not have yet, or to which it has just been introduced:
its answer to their registration came to the gate, not to them.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any, Tuple

from rigel_gate.calls import GATE, Call, Removal
from rigel_gate.context import Context
from rigel_gate.handover import list_heard
from rigel_gate.links import NodeGone, NodeSilent
from rigel_gate.registry import PARAMETER, PUBLISHER, SUBSCRIBER, Registration

#: Seconds that a node has to answer before it counts as silent.
PATIENCE = 3.0
#: Seconds that a change waits for a node to receive what was true before it.
SETTLE = 0.5
#: Seconds that a node has to stop publishing after its shutdown, for one look, and between two.
STOP, STOP_LOOK, STOP_PAUSE = 1.0, 0.03, 0.01
#: What nodes are sent: the publishers of a topic, the value of a parameter.
PUBLISHERS, VALUE = "publisherUpdate", "paramUpdate"
#: The caller's name, as nodes see it; masters have none.
MASTER = "/master"
#: A call of a node: its URI, the method, the topic or parameter.
Target = Tuple[str, str, str]


class Nodes:
    """All nodes, whether they have names or wait for them."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._state = context.state
        self._under_way: dict[Target, asyncio.Future[None]] = {}
        self._again: set[Target] = set()  # those in progress that must be made again
        self._unsent: dict[Target, float] = {}  # those that failed, and when to try again

    # -- whether they are there --

    async def find(self, api: str) -> bool | None:
        """Return whether a node is at its address; None: its machine cannot be reached."""
        try:
            await self._context.links.connect(api, PATIENCE)
        except NodeGone:
            return False
        except NodeSilent:
            return None
        return True

    async def stop(self, api: str) -> None:
        """Shut a node down; return when it no longer publishes, or when STOP is over.

        The answer to the shutdown does not mean that: roscpp's comes before the node stops, rospy's
        a tenth of a second after. Both close all publishers at once, after they have unregistered.
        """
        self._context.spawn(self._shut_down(api))
        until = self._context.links.now() + STOP
        while self._context.links.now() < until and await self._publishes(api):
            await self._context.links.sleep(STOP_PAUSE)

    async def _shut_down(self, api: str) -> None:
        with suppress(NodeGone, NodeSilent):
            why = "another node has taken over its name"
            await self._context.links.node(api, Call("shutdown", (MASTER, why)), PATIENCE)

    async def _publishes(self, api: str) -> bool:
        """Return whether a node has publishers; one that does not answer in time may have some.

        rospy often leaves the last call without an answer. The next one is refused then.
        """
        call = Call("getPublications", (GATE,))
        try:
            answer = await self._context.links.node(api, call, STOP_LOOK)
        except NodeGone:
            return False
        except NodeSilent:
            return True
        return bool(answer.result)

    # -- what they receive --

    def send_publishers(self, api: str, topic: str) -> None:
        """Send a node the list of a topic's publishers."""
        self._send((api, PUBLISHERS, topic))

    def send_parameter(self, api: str, key: str) -> None:
        self._send((api, VALUE, key))

    def send_answer(self, one: Registration) -> None:
        """Send a node the master's answer to a registration that the gate made."""
        if one.kind == SUBSCRIBER:
            self.send_publishers(one.api, one.key)
        elif one.kind == PARAMETER:
            self.send_parameter(one.api, one.key)

    def send_again(self) -> None:
        """Call nodes that were silent, while they are known."""
        for target, due in list(self._unsent.items()):
            if not self._state.has_node(target[0]):
                del self._unsent[target]
            elif due <= self._context.links.now():
                self._send(target)

    async def settle(self, changed: Registration | Removal) -> None:
        """Wait before a topic's publishers change until nodes have got the list as it is.

        The master sends the next list itself, and one of the gate's must not arrive after it:
        roscpp ends its connection to a publisher that is not on the list.
        """
        if changed.kind != PUBLISHER:
            return
        until = self._context.links.now() + SETTLE
        while True:
            found = [one for (_, _, key), one in self._under_way.items() if key == changed.key]
            sent = [one for one in found if not one.done()]
            if not sent:
                return
            left = max(0.0, until - self._context.links.now())
            for late in (await asyncio.wait(sent, timeout=left))[1]:
                late.cancel()

    def _send(self, target: Target) -> None:
        """Make a call, or make it again after the same one that is in progress."""
        if target in self._under_way:
            self._again.add(target)
        else:
            self._under_way[target] = asyncio.get_running_loop().create_future()
            self._context.spawn(self._deliver(target))

    async def _deliver(self, target: Target) -> None:
        api, method, key = target
        value = self._read(target)
        try:
            await self._context.links.node(api, Call(method, (MASTER, key, value)), PATIENCE)
        except NodeGone:
            return
        except NodeSilent as error:
            if target not in self._unsent:
                self._context.log(f"{method} of {key} does not reach {api}: {error}")
            self._unsent[target] = self._context.links.now() + PATIENCE
            return
        finally:
            sent = self._under_way.pop(target)
            is_late = sent.cancelled()  # a change has not waited any longer
            sent.cancel()
            again = target in self._again
            self._again.discard(target)
        self._unsent.pop(target, None)
        if is_late or method == VALUE:  # the master may have sent a later value before this one
            async with self._context.turn:  # the state has then what the master had
                pass
            again = again or self._read(target) != value
        if again:
            self._send(target)

    def _read(self, target: Target) -> Any:
        """Return what to send to a node."""
        api, method, key = target
        if method == PUBLISHERS:
            return list_heard(self._state, key, api)
        return self._state.parameters.get(key)
