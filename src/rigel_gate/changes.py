"""Calls that change the master's registrations: one at a time, and the state changes with it.

A registration is passed to the master, or its node waits for the name (newcomers.py).
"""

from __future__ import annotations

import asyncio
from functools import partial

from rigel_gate.calls import Answer, Call, Removal, fault, registration_of, removal_of
from rigel_gate.context import Context
from rigel_gate.handover import find_owner
from rigel_gate.master import Master
from rigel_gate.newcomers import Newcomers
from rigel_gate.nodes import Nodes
from rigel_gate.parameters import Parameters
from rigel_gate.registry import Registration, resolve_name
from rigel_gate.state import pack, unpack
from rigel_gate.takeover import TakeOver


class Changes:
    """Answers these calls."""

    def __init__(
        self,
        context: Context,
        master: Master,
        nodes: Nodes,
        newcomers: Newcomers,
        takeover: TakeOver,
    ) -> None:
        self._context = context
        self._state = context.state
        self._master = master
        self._nodes = nodes
        self._newcomers = newcomers
        self._takeover = takeover

    async def answer(self, call: Call, *, hands_over: bool) -> Answer | None:
        """Return the answer to a call, None for one that changes nothing; may raise BadCall.

        Args:
            hands_over: it came by the door of nodes that hand their names over.
        """
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
            return await self._change_parameter(call, ("delete", resolve_name(key, node)))
        return None

    async def _register(self, call: Call, one: Registration, *, hands_over: bool) -> Answer:
        while True:
            before = self._state.registry.api_of(one.node)
            lives = False
            if before not in (None, one.api):
                lives, there = await asyncio.gather(
                    self._nodes.lives(str(before)), self._nodes.find(one.api)
                )
                if there is False:  # its call has waited, for the master perhaps
                    return fault(f"{one.node} at {one.api} has ended")
            async with self._context.turn:
                if self._state.registry.api_of(one.node) != before:
                    continue
                waits = (one.node, one.api) in self._state.newcomers
                if not waits:
                    owner = find_owner(self._state, one, hands_over=hands_over)
                    waits = lives and owner is not None
                if waits:
                    self._newcomers.wait(one)
                    break
                if self._master.is_ready:
                    if lives:
                        self._takeover.note_conflict(one, str(before))
                    answer = await self._master.call(call, partial(self._nodes.settle, one))
                    if answer.is_success and not self._state.registry.has(one):
                        self._context.note("register", *one, hands_over)
                    return answer
            await self._master.until_ready()  # and look again: much may change meanwhile
        return await self._newcomers.answer(one)

    async def _unregister(self, call: Call, removal: Removal) -> Answer:
        if removal in self._context.lapsing:
            return answer_removal(removal)
        self._context.removals.append(removal)
        try:
            return await self._remove(call, removal)
        finally:
            self._context.removals.remove(removal)

    async def _remove(self, call: Call, removal: Removal) -> Answer:
        async with self._context.turn:
            if self._newcomers.take_back(removal):
                return answer_removal(removal)
            answer = await self._master.call(call, partial(self._nodes.settle, removal))
            if answer.is_success:
                self._context.note("unregister", *removal)
            if self._state.registry.api_of(removal.node) is None:
                self._context.spawn(self._takeover.give_free(removal.node))
            return answer

    async def _set_parameter(self, call: Call) -> Answer:
        """Set a parameter, unless it is one that could not be given to the next master."""
        node, key = call.texts(2)
        name, value = resolve_name(key, node), call.params[2]
        try:
            packed = pack(value)
            Parameters().set(name, unpack(packed))
        except Exception as error:  # of xmlrpc.client: a large number, a date that is none
            return fault(f"{name} cannot be set: {error!r}")
        return await self._change_parameter(call, ("set", name, packed))

    async def _change_parameter(self, call: Call, event: tuple[str, ...]) -> Answer:
        async with self._context.turn:
            answer = await self._master.call(call)
            if answer.is_success:
                self._context.note(*event)
                self._newcomers.send_parameter(event[1])
            return answer


def answer_removal(removal: Removal) -> Answer:
    """Return what the master answers when it has removed a registration."""
    return Answer.good(f"Unregistered [{removal.node}]", 1)
