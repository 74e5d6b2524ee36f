"""The gate: every call to the master arrives here.

A call that changes registrations is passed to the master, or its node waits for the name. The parts
that decide when a name changes hands, and what a new master gets, are modules of their own.
"""

from __future__ import annotations

import asyncio
import json
from functools import partial
from typing import Any, Callable, TypeVar

from rigel_gate.calls import (
    DESCRIBE_GATE,
    DESCRIBE_POD,
    HAND_OVER,
    LARGE,
    Answer,
    BadCall,
    Call,
    Removal,
    fault,
    registration_of,
    removal_of,
)
from rigel_gate.context import Context
from rigel_gate.handover import are_rivals, find_own_service, find_owner
from rigel_gate.links import Links
from rigel_gate.master import Master
from rigel_gate.newcomers import Newcomers
from rigel_gate.nodes import Nodes
from rigel_gate.parameters import LARGEST_TREE, Parameters, copy_tree, size_of
from rigel_gate.registry import Registration, host_of, resolve_name
from rigel_gate.restoring import Restoring
from rigel_gate.state import Event, State, WrittenEvent, pack, unpack
from rigel_gate.takeover import TakeOver

#: Seconds between two checks of the nodes that wait for a name and of those that have it.
LOOK = 0.25
#: Bytes that the answers to the calls of one `system.multicall` may have together.
LARGEST = 16 * 2**20

T = TypeVar("T")


class Gate:
    """Answers calls; see the module.

    Args:
        state: what an earlier gate has left, or an empty one.
        uri: the gate's own, which callers use as the master's.
        keep: called with each event before its cause is answered.
        log: called with a line for people to read.
        list_troubles: returns why the state is not kept, for `describe`.
        list_notes: returns what else users should know of the gate's process.
    """

    def __init__(
        self,
        state: State,
        links: Links,
        uri: str,
        keep: Callable[[Event], None],
        log: Callable[[str], None],
        list_troubles: Callable[[], list[str]] = list,
        list_notes: Callable[[], list[str]] = list,
    ) -> None:
        self.state = state
        self._uri = uri
        self._list_troubles = list_troubles
        self._list_notes = list_notes
        self._context = Context(state, links, keep, log)
        self._master = Master(self._context)
        self._nodes = Nodes(self._context)
        self._restoring = Restoring(self._context, self._master, self._nodes)
        self._newcomers = Newcomers(self._context, self._master, self._nodes)
        self._takeover = TakeOver(self._context, self._master, self._nodes, self._newcomers)

    def start(self) -> None:
        """Look for the master, and check the nodes that wait, until stopped."""
        self._master.start(self._restoring.complete_master, self._takeover.finish)
        self._context.spawn(self._watch_nodes())

    async def until_ready(self) -> None:
        """Return when the master answers and has all registrations."""
        await self._master.until_ready()

    async def stop(self) -> None:
        """End everything that runs."""
        await self._context.stop()

    async def answer(self, call: Call, *, hands_over: bool, host: str = "") -> Answer:
        """Return the answer to a call.

        Args:
            hands_over: it came by the door of nodes that hand their names over.
            host: the address that it came from. A call from this pod does not wait for a master
                that is down: it may be from roscore itself, which looks for another one before it
                starts its own.
        """
        if call.method == DESCRIBE_GATE:
            return Answer.good("", json.dumps(self.describe()))
        if host.startswith("127.") and not await self._master.is_there():
            return fault("no ROS master answers behind the gate yet")
        if call.method == DESCRIBE_POD:
            return await self._takeover.describe_pod(call)
        if call.method == HAND_OVER:
            return await self._takeover.hand_over(call)
        if call.method == "getUri":
            return Answer.good("", self._uri)
        if call.method == "system.multicall":
            return await self._answer_many(call, hands_over=hands_over, host=host)
        try:
            if call.method == "lookupService" and hands_over:
                return await self._find_service(call, host)
            answer = await self._change(call, hands_over=hands_over)
        except BadCall:  # the master answers with its own error
            answer = None
        return answer or await self._master.ask(call)

    async def _answer_many(self, call: Call, *, hands_over: bool, host: str) -> Answer:
        answers: list[Any] = []
        size = 0
        try:
            calls = [
                Call(one["methodName"], tuple(one["params"]), is_large=call.is_large)
                for one in call.params[0]
            ]
        except (BadCall, LookupError, TypeError):
            return await self._master.ask(call)
        for one in calls:
            answer = await self.answer(one, hands_over=hands_over, host=host)
            size += len(answer.body)
            if size > LARGEST:
                return fault(f"the answers have more than {LARGEST} bytes")
            read = partial(getattr, answer, "value")
            answers.append([await self._in_thread(read, is_large=len(answer.body) > LARGE)])
        made = Answer(answers)
        await self._in_thread(partial(getattr, made, "body"), is_large=size > LARGE)
        return made

    async def _in_thread(self, work: Callable[[], T], *, is_large: bool) -> T:
        return await self._context.links.compute(work) if is_large else work()

    async def _find_service(self, call: Call, host: str) -> Answer:
        """Return where a pod that hands over finds a service: first in the pod itself."""
        node, key = call.texts(2)
        own = find_own_service(self.state, resolve_name(key, node), host)
        if own:
            return Answer.good("rosrpc URI", own)
        answer = await self._master.ask(call)  # this may wait until a name has changed hands
        if answer.is_success and are_rivals(self.state, node, host, host_of(answer.result)):
            return Answer([-1, "no provider", ""])
        return answer

    # -- calls that change registrations: one at a time, and the state changes with each --

    async def _change(self, call: Call, *, hands_over: bool) -> Answer | None:
        """Return the answer to a call, None for one that changes nothing; may raise BadCall."""
        one = registration_of(call)
        if one:
            return await self._register(call, one, hands_over=hands_over)
        removal = removal_of(call)
        if removal:
            return await self._unregister(call, removal)
        if call.method == "setParam" and len(call.params) == 3:
            return await self._set_parameter(call)
        if call.method == "deleteParam":
            node, key = call.texts(2)
            name = resolve_name(key, node)
            note = partial(self._context.note, "delete", name)
            return await self._change_parameter(call, name, note)
        return None

    async def _register(self, call: Call, one: Registration, *, hands_over: bool) -> Answer:
        while True:
            before = self.state.registry.api_of(one.node)
            lives = False
            if before not in (None, one.api):
                there, own = await asyncio.gather(
                    self._nodes.find(str(before)), self._nodes.find(one.api)
                )
                lives = there is True
                if own is False:  # its call has waited, for the master perhaps
                    return fault(f"{one.node} at {one.api} has ended")
            async with self._context.turn:
                if self.state.registry.api_of(one.node) != before:
                    continue
                waits = (one.node, one.api) in self.state.newcomers
                if not waits:
                    owner = find_owner(self.state, one, hands_over=hands_over)
                    waits = lives and owner is not None
                if waits:
                    self._newcomers.wait(one)
                    break
                if self._master.is_ready:
                    if lives:
                        self._takeover.note_conflict(one, str(before))
                    answer = await self._master.call(call, partial(self._nodes.settle, one))
                    if answer.is_success and not self.state.registry.has(one):
                        self._context.note("register", *one, hands_over)
                    return answer
            await self._master.until_ready()  # and look again: much may change meanwhile
        return await self._newcomers.answer(one)

    async def _unregister(self, call: Call, removal: Removal) -> Answer:
        if removal in self._context.lapsing:
            return answer_removal(removal)
        self._context.removals.append(removal)
        try:
            async with self._context.turn:
                if self._newcomers.take_back(removal):
                    return answer_removal(removal)
                answer = await self._master.call(call, partial(self._nodes.settle, removal))
                if answer.is_success:
                    self._context.note("unregister", *removal)
                if self.state.registry.api_of(removal.node) is None:
                    self._context.spawn(self._takeover.give_free(removal.node))
                return answer
        finally:
            self._context.removals.remove(removal)

    async def _set_parameter(self, call: Call) -> Answer:
        """Set a parameter, unless it is one that could not be given to the next master."""
        node, key = call.texts(2)
        name = resolve_name(key, node)
        work = partial(prepare, call, name)
        try:
            event, value, size = await self._in_thread(work, is_large=call.is_large)
        except Exception as error:  # of xmlrpc.client: a large number, a date that is none
            return fault(f"{name} cannot be set: {error!r}")
        if self.state.parameters.size + size > LARGEST_TREE and not await self._fits(name, size):
            return fault(f"{name} cannot be set: all parameters have at most {LARGEST_TREE} bytes")
        note = partial(self._context.note_value, event, value, size)
        return await self._change_parameter(call, name, note)

    async def _fits(self, name: str, size: int) -> bool:
        """Count the parameters; return whether they may have a value of this size, too."""
        known = self.state.parameters
        tree, before = copy_tree(known.tree), known.size
        counted = await self._context.links.compute(partial(size_of, tree))
        replaced = await self._context.links.compute(partial(size_of, known.get(name)))
        known.size += counted - before
        return known.size - replaced + size <= LARGEST_TREE

    async def _change_parameter(self, call: Call, name: str, note: Callable[[], None]) -> Answer:
        async with self._context.turn:
            answer = await self._master.call(call)
            if answer.is_success:
                note()
                self._newcomers.send_parameter(name)
            return answer

    # -- from time to time --

    async def _watch_nodes(self) -> None:
        """Check nodes from time to time."""
        while True:
            await self._context.links.sleep(LOOK)
            try:
                self._takeover.look_around()
                self._nodes.send_again()
                self._takeover.forget_pods()
                await self._restoring.look_around()
            except Exception as error:  # a failure here must not end all hand-overs
                self._context.log(f"error: {error!r}")

    def describe(self) -> dict[str, Any]:
        """Return what `rigel status` shows of the gate."""
        return {
            "waiting": [
                {"node": one.name, "api": one.api, "owner": self.state.registry.api_of(one.name)}
                for one in self.state.newcomers.values()
            ],
            "conflicts": self._takeover.list_conflicts(),
            "has_master": self._master.is_ready,
            "silent": sorted(self.state.silent),
            "restarts": self._restoring.restarts,
            "blocked": self._master.trouble,
            "refused": self._restoring.refused,
            "unkept": self._list_troubles(),
            "notes": self._list_notes(),
            "nodes": len(self.state.registry.nodes),
        }


def answer_removal(removal: Removal) -> Answer:
    """Return what the master answers when it has removed a registration."""
    return Answer.good(f"Unregistered [{removal.node}]", 1)


def prepare(call: Call, name: str) -> tuple[Event, Any, int]:
    """Return the event of a `setParam`, its value as a later gate reads it, and its size.

    Raises whatever keeps it from being read or written again.
    """
    packed = pack(call.params[2])
    value = unpack(packed)
    Parameters().set(name, value)
    event: Event = ["set", name, packed]
    if call.is_large:
        event = WrittenEvent(event)
        _ = call.body  # which is made here
    return event, value, size_of(value)
