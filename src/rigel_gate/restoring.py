"""Brings a returning master and the state into agreement.

A master that has restarted is given what it is missing. A master that continued while no gate ran
is trusted. recovery.py compares the two; this module calls, waits and notes.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any, Iterable, Iterator, Sequence, TypeVar

from rigel_gate.calls import GATE, Call, call_of, describe_call
from rigel_gate.context import Context
from rigel_gate.links import NodeGone, NodeSilent
from rigel_gate.master import Master
from rigel_gate.nodes import PATIENCE, Nodes
from rigel_gate.parameters import OF_ROSCORE, copy_tree, is_same, list_pieces, size_of
from rigel_gate.recovery import (
    Known,
    find_lost_nodes,
    find_lost_parameters,
    find_unknown,
    find_unregistered,
    is_same_node,
    list_refusals,
    list_topics_without,
    read_system,
)
from rigel_gate.registry import (
    ROSOUT,
    SERVICE,
    SUBSCRIBER,
    NodeEntry,
    Registration,
    host_of,
)
from rigel_gate.state import pack

#: Calls that a new master receives in one request, and about how many bytes of them.
BATCH, LARGEST_BATCH = 100, 2**20
#: Bytes of parameters, by `size_of`, that are read from a master in one answer.
LARGEST_ANSWER = 16 * 2**20

T = TypeVar("T")


class Restoring:
    """What happens between a master's first answer and the first call that reaches it.

    Attributes:
        restarts: how many masters were given their registrations again.
        refused: the registrations and parameters that the last one did not accept, and why.
    """

    def __init__(self, context: Context, master: Master, nodes: Nodes) -> None:
        self._context = context
        self._state = context.state
        self._master = master
        self._nodes = nodes
        self.restarts = 0
        self.refused: list[str] = []

    async def complete_master(self) -> None:
        """Make a master that answers complete; raises MasterGone if it ends meanwhile."""
        system = await self._ask_now("getSystemState")
        run = str(await self._ask_now("getParam", "/run_id") or "")
        known = read_system(system)
        if not self._master.has_started and run and run == self._state.run:
            await self._follow_master(known)
            return
        names = await self._ask_now("getParamNames") or []
        firsts = {name.partition("/")[2].partition("/")[0] for name in names}
        knows_none = not self._state.run and not firsts.issubset(OF_ROSCORE)
        nodes = [n for n in find_lost_nodes(self._state, known) if n not in self._state.silent]
        parameters = find_lost_parameters(self._state, names)
        if nodes or parameters:
            await self._give_back(nodes, parameters)
        if nodes or parameters or run != self._state.run:
            self._context.note("run", run)
        if not self._master.has_started:
            await self._adopt(known)
            if knows_none:
                await self._follow_parameters()

    async def look_around(self) -> None:
        """Check nodes that were silent, and a master that has had no number yet."""
        if self._master.is_ready:
            for name in sorted(self._state.silent):
                self._context.spawn_once(name, self._try_again)
            if not self._state.run:
                await self._note_run()

    async def _ask_now(self, method: str, *params: Any) -> Any:
        """Return the answer of a master that may not be complete yet, None for an error."""
        return (await self._context.links.master(Call(method, (GATE, *params)))).result

    # -- a new master --

    async def _give_back(self, nodes: list[str], parameters: list[tuple[str, Any]]) -> None:
        """Register again what a new master is missing, as far as it is still true."""
        self.restarts += 1
        self.refused.clear()
        entries = [self._state.registry.nodes[name] for name in nodes if name != ROSOUT]
        lives = await asyncio.gather(*(self._is_there(entry) for entry in entries))
        gone: list[Registration] = []
        for entry, is_alive in zip(entries, lives):
            if is_alive is False:
                gone += entry.registrations.values()
                self._context.note("forget", entry.name)
        for entry, is_alive in zip(entries, lives):
            if is_alive is None:
                self._context.note("silent", entry.name)
        kept = {entry.name for entry, is_alive in zip(entries, lives) if is_alive}
        await self._make_calls([Call("setParam", (GATE, *pair)) for pair in parameters])
        again = [one for one in self._state.registry.all() if one.node in kept]
        await self._make_calls([call_of(one) for one in again])
        self._send_shrunk(gone)
        self._context.log(
            f"a new master: restored {len(again)} registrations of {len(kept)} nodes and"
            f" {len(parameters)} parameters; ended: {len({o.node for o in gone})} nodes,"
            f" unreachable: {len(self._state.silent)}"
        )

    async def _make_calls(self, calls: Sequence[Call]) -> None:
        """Make many calls in few requests; note what the master refuses."""
        for some in divide(calls, [size_of(list(one.params)) for one in calls]):
            listed = [{"methodName": one.method, "params": list(one.params)} for one in some]
            answer = await self._context.links.master(Call("system.multicall", (listed,)))
            refusals = list_refusals(answer.value, len(some))
            if len(some) > 1 and all(refusals):  # perhaps one of them spoils the request
                for one in some:
                    await self._make_calls([one])
                continue
            for one, why in zip(some, refusals):
                if why:
                    self.refused.append(f"{describe_call(one)}: {why}")
                    self._context.log(f"the master refuses {self.refused[-1]}")

    async def _is_there(self, entry: NodeEntry) -> bool | None:
        """Return whether a node still runs at its address; None: it is not known now."""
        try:
            call = Call("getPublications", (GATE,))
            answer = await self._context.links.node(entry.api, call, PATIENCE)
            leaving = {(one.kind, one.key, one.node) for one in self._context.removals}
            own = [
                one
                for one in entry.registrations.values()
                if (one.kind, one.key, one.node) not in leaving
            ]
            return is_same_node(own, answer.result)
        except NodeGone:
            return False
        except NodeSilent:
            return None
        except Exception as error:  # whatever one node does, the others go on
            self._context.log(f"error: {entry.name} at {entry.api}: {error!r}")
            return False

    async def _try_again(self, name: str) -> None:
        """Register a node that was silent when the master came back, once it answers."""
        entry = self._state.registry.nodes.get(name)
        is_alive = await self._is_there(entry) if entry else False
        if is_alive is None:
            await self._context.links.sleep(PATIENCE)
            return
        async with self._context.turn:
            if name not in self._state.silent or self._state.registry.nodes.get(name) is not entry:
                return
            if entry is None or not is_alive:
                self._context.note("forget", name)
                self._send_shrunk(entry.registrations.values() if entry else ())
                return
            run = None
            while run != self._state.run:  # another, empty master may start meanwhile
                run = self._state.run
                await self._register_all(entry)
            self._context.note("answers", name)
            self._context.log(f"{name} answers again: it is registered with the new master")

    async def _register_all(self, entry: NodeEntry) -> None:
        for one in entry.all():
            await self._master.call(call_of(one), partial(self._nodes.settle, one))
            self._nodes.send_answer(one)

    def _send_shrunk(self, gone: Iterable[Registration]) -> None:
        """Send subscribers the publishers that are left."""
        for topic in list_topics_without(gone):
            for one in self._state.registry.find(SUBSCRIBER, topic):
                self._nodes.send_answer(one)

    # -- a master that continued while no gate ran --

    async def _follow_master(self, known: Known) -> None:
        """Trust a master that has not restarted: changes may have been in progress."""
        for one in find_unregistered(self._state, known):
            if one.node in self._state.silent:  # which the master does not have
                continue
            uri = one.detail if one.kind == SERVICE else one.api
            self._context.note("unregister", one.kind, one.key, one.node, uri)
        for entry in list(self._state.registry.nodes.values()):
            api = await self._ask_now("lookupNode", entry.name)
            if api and api != entry.api:
                self._context.note("forget", entry.name)
        await self._adopt(known)
        await self._follow_parameters()

    async def _follow_parameters(self) -> None:
        """Note how a master's parameters differ."""
        own = self._state.parameters
        if own.size > LARGEST_ANSWER:
            self._context.spawn(self._compare_parameters())
            return
        tree = await self._ask_now("getParam", "/")
        if isinstance(tree, dict) and not is_same(tree, own.tree):
            self._context.note("set", "/", pack(tree))

    async def _compare_parameters(self) -> None:
        """Note how a master's parameters differ, part by part, while calls are answered.

        What has changed in a namespace that comes in pieces, and a name that only the master has,
        stays unknown: their calls were not answered.
        """
        own, compute = self._state.parameters, self._context.links.compute
        for name, piece in list_pieces(copy_tree(own.tree)):
            if isinstance(piece, dict) and piece.keys() != own.get(name).keys():
                continue
            async with self._context.turn:
                answer = await self._master.call(Call("getParam", (GATE, name)))
                value = await compute(partial(getattr, answer, "result"))
                if answer.is_success and not is_same(value, own.get(name)):
                    self._context.note("set", name, pack(value))
                elif not answer.is_success:
                    there = await self._master.call(Call("hasParam", (GATE, name)))
                    if there.result is False:
                        self._context.note("delete", name)

    async def _adopt(self, known: Known) -> None:
        """Note what a master has and the state has not."""
        unknown = list(find_unknown(self._state, known))
        if not unknown:
            return
        types = dict(await self._ask_now("getTopicTypes") or [])
        hosts = {host_of(e.api) for e in self._state.registry.nodes.values() if e.hands_over}
        hosts |= self._state.pods.keys()
        for kind, key, node in unknown:
            api = await self._ask_now("lookupNode", node)
            detail = types.get(key, "*")
            if kind == SERVICE:
                detail = await self._ask_now("lookupService", key)
            if api and detail:
                self._context.note("register", kind, key, node, api, detail, host_of(api) in hosts)

    async def _note_run(self) -> None:
        """Remember which master this is, once roscore has given it its number."""
        run = (await self._master.call(Call("getParam", (GATE, "/run_id")))).result
        if run and not self._state.run:
            self._context.note("run", str(run))


def divide(items: Sequence[T], sizes: Sequence[int]) -> Iterator[Sequence[T]]:
    """Yield items in parts, each of BATCH items and of LARGEST_BATCH bytes at most, or of one."""
    start = size = 0
    for end, own in enumerate(sizes):
        if end > start and (end - start == BATCH or size + own > LARGEST_BATCH):
            yield items[start:end]
            start, size = end, 0
        size += own
    if items:
        yield items[start:]
