"""When a name changes hands, and how: the master has one owner before, and one after.

A name passes to a newcomer when the pod of the node that has it ends, when that node itself ends,
or when the newcomer belongs to another workload. handover.py says which newcomer gets it.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from functools import partial
from typing import Any

from rigel_gate.calls import Answer, BadCall, Call, call_of
from rigel_gate.context import Context
from rigel_gate.handover import (
    choose_heir,
    find_strangers,
    is_quiet,
    list_names_of,
    list_removals,
)
from rigel_gate.master import Master
from rigel_gate.newcomers import Newcomers
from rigel_gate.nodes import Nodes
from rigel_gate.registry import Registration, host_of
from rigel_gate.state import GatePod, Newcomer

#: Seconds between two looks at a newcomer that is not quiet yet, while a pod waits to end.
PAUSE = 0.05
#: How many conflicts are remembered.
CONFLICTS = 20
#: Seconds without a word of a pod's probe, and without a node there, after which it is forgotten.
FORGET = 600.0
#: Seconds that a pod can wait for those that take over.
LONGEST = 3600.0
#: How many addresses one pod may have.
MOST_HOSTS = 64


class TakeOver:
    """Gives names to those that wait for them."""

    def __init__(
        self, context: Context, master: Master, nodes: Nodes, newcomers: Newcomers
    ) -> None:
        self._context = context
        self._state = context.state
        self._master = master
        self._nodes = nodes
        self._newcomers = newcomers
        self._conflicts: deque[dict[str, Any]] = deque(maxlen=CONFLICTS)
        self._described: dict[str, float] = {}  # when a pod's probe last came, by its address

    # -- what pods request --

    async def describe_pod(self, call: Call) -> Answer:
        """Note how a pod describes itself; return its nodes that wait.

        Arguments: caller, pod, workload, then the addresses of its nodes. Each node is returned as
        [name, URI, "quiet" or "busy", URI of the one that has the name].
        """
        _, pod, workload, *hosts = call.texts(len(call.params))
        check_hosts(hosts)
        found = []
        for host in hosts:
            self._described[host] = self._context.links.now()
            described = GatePod(host, pod, workload)
            if self._state.pods.get(host) != described:
                self._context.note("pod", *described)
            for newcomer in self._state.newcomers_at(host):
                quiet = "quiet" if self._is_quiet(newcomer) else "busy"
                owner = self._state.registry.api_of(newcomer.name) or ""
                found.append([newcomer.name, newcomer.api, quiet, owner])
        for stranger in list(find_strangers(self._state)):
            before = self._state.registry.api_of(stranger.name) or ""
            self.note_conflict(next(iter(stranger.registrations.values())), before)
            self._context.spawn(self._pass_name(stranger.name, stranger.api, before or None))
        return Answer.good("", found)

    async def hand_over(self, call: Call) -> Answer:
        """Give the names of a pod that ends to those that wait for them; return these names.

        Arguments: caller, seconds that newcomers have to become quiet, the pod's addresses.
        """
        _, seconds, *hosts = call.texts(len(call.params))
        check_hosts(hosts)
        deadline = self._context.links.now() + read_seconds(seconds)
        for host in hosts:
            self._context.note("leave", host)
        names = [name for host in hosts for name in list_names_of(self._state, host)]
        return Answer.good(
            "", [name for name in names if await self._hand_over_name(name, deadline)]
        )

    async def _hand_over_name(self, name: str, deadline: float) -> bool:
        """Give a name to the node that waits for it, once quiet; return whether one got it."""
        owner = self._state.registry.api_of(name)
        while self._state.registry.api_of(name) == owner:
            heir = self._choose_heir(name)
            if heir is None:
                return False
            await self._newcomers.visit(heir)
            if heir is not self._choose_heir(name):
                continue
            if self._is_quiet(heir) or self._context.links.now() >= deadline:
                await self._pass_name(heir.name, heir.api, owner)
            else:
                await self._context.links.sleep(PAUSE)
        return self._state.registry.api_of(name) is not None

    # -- a name without a node --

    async def give_free(self, name: str) -> None:
        """Give a name that no node has any more to the one that waits for it."""
        heir = self._choose_heir(name)
        if heir:
            await self._pass_name(heir.name, heir.api, None)

    async def finish(self) -> None:
        """Finish what an earlier gate had begun when it ended: its nodes have half of it.

        That gate may also have ended before a node received the master's answer about it, or while
        rospy, connecting to a publisher, asked for the parameter `/tcp_keepalive`: it then drops
        the connection, and only another list of publishers makes it connect again.
        """
        for newcomer in list(self._state.newcomers.values()):
            if self._state.registry.api_of(newcomer.name) == newcomer.api:
                await self._pass_name(newcomer.name, newcomer.api, newcomer.api)
        for entry in self._state.registry.nodes.values():
            if entry.name not in self._state.silent:
                for one in entry.registrations.values():
                    self._nodes.send_answer(one)

    def look_around(self) -> None:
        """Check whether newcomers live, and those whose names they wait for."""
        for name in sorted({one.name for one in self._state.newcomers.values()}):
            self._context.spawn_once(name, self._look_at)

    def forget_pods(self) -> None:
        """Forget pods that have ended: no node has a name there or waits for one.

        One that has handed over is known to end. Of one that is killed, the probe falls silent.
        """
        now = self._context.links.now()
        quiet = [h for h in self._state.pods if now - self._described.setdefault(h, now) > FORGET]
        for host in sorted(self._state.leaving.union(quiet)):
            if not list_names_of(self._state, host) and not self._state.newcomers_at(host):
                self._context.note("away", host)
                self._described.pop(host, None)

    async def _look_at(self, name: str) -> None:
        await asyncio.gather(*map(self._newcomers.visit, self._state.newcomers_for(name)))
        owner = self._state.registry.api_of(name)
        heir = self._choose_heir(name)
        if heir is None:
            return
        free = owner is None or owner == heir.api or await self._nodes.find(owner) is not True
        if not free and host_of(str(owner)) in self._state.leaving:
            free = self._is_quiet(heir)
        if free:
            await self._pass_name(heir.name, heir.api, owner)

    # -- how it changes hands --

    async def _pass_name(self, name: str, api: str, owner: str | None) -> None:
        """Give a waiting node its name, after the old owner has shut down and stopped publishing.

        The master shuts it down, too, but only when it already introduces the new node to others,
        which would receive from both for a moment.

        Args:
            owner: which node has the name, as the caller has seen it. Another one may have got it
                before this takes its turn, such as one that has started again in its pod.
        """
        async with self._context.turn:
            newcomer = self._state.newcomers.get((name, api))
            if newcomer is None or self._state.registry.api_of(name) != owner:
                return
            async with self._master.handing_over():
                if owner not in (None, api):
                    self._context.lapsing = list_removals(self._state, name)
                    try:
                        await self._nodes.stop(str(owner))
                    finally:
                        self._context.lapsing = frozenset()
                await self._register_all(newcomer)
            self._context.note("dismiss", name, api)
        self._context.log(f"{name} at {api} has taken over")

    async def _register_all(self, newcomer: Newcomer) -> None:
        """Register all that a newcomer has, and send it the master's answers."""
        for one in newcomer.all():
            answer = await self._master.call(call_of(one), partial(self._nodes.settle, one))
            if not answer.is_success:
                self._context.log(
                    f"the master refuses {one.kind} {one.key} of {one.node}: {answer.value}"
                )
                continue
            self._context.note("register", *one, True)
            self._nodes.send_answer(one)

    def _choose_heir(self, name: str) -> Newcomer | None:
        return choose_heir(self._state, name, self._context.links.now())

    def _is_quiet(self, newcomer: Newcomer) -> bool:
        return is_quiet(newcomer, self._context.links.now())

    # -- names that are taken without a hand-over --

    def note_conflict(self, one: Registration, before: str) -> None:
        """Remember that a node lost its name to a younger one that does not replace it."""
        if host_of(before) in (one.host, *self._state.leaving):
            return
        last = self._conflicts[-1] if self._conflicts else {}
        if (last.get("node"), last.get("new")) != (one.node, one.api):
            self._conflicts.append(
                {"node": one.node, "old": before, "new": one.api, "time": self._context.links.now()}
            )
            self._context.log(f"{one.node} at {before} loses its name to the node at {one.api}")

    def list_conflicts(self) -> list[dict[str, Any]]:
        """Return the latest conflicts, each with its age in seconds as `time`."""
        now = self._context.links.now()
        return [{**one, "time": now - one["time"]} for one in self._conflicts]


def check_hosts(hosts: list[str]) -> None:
    """Raise BadCall for more addresses than a pod can have."""
    if len(hosts) > MOST_HOSTS:
        raise BadCall(f"a pod has at most {MOST_HOSTS} addresses")


def read_seconds(text: str) -> float:
    """Return the seconds of a text, LONGEST at most; raises BadCall."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise BadCall(f"not a number of seconds: {text:.40}")
    return min(seconds, LONGEST)
