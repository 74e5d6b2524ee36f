"""The gate: every call to the master passes here, and what it changes is remembered.

Changes take turns, so that what the gate knows is what the master knows. While the master is away,
and while a name changes hands, calls wait; nobody sees a half of it.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from typing import Any, Callable

from rigel_k8s.gate.calls import (
    DESCRIBE_GATE,
    DESCRIBE_POD,
    HAND_OVER,
    Answer,
    BadCall,
    Call,
    Removal,
    call_of,
    fault,
    registration_of,
    removal_of,
)
from rigel_k8s.gate.context import Context
from rigel_k8s.gate.handover import (
    choose_heir,
    find_owner,
    find_strangers,
    is_quiet,
    list_names_of,
    list_publishers,
)
from rigel_k8s.gate.links import Links
from rigel_k8s.gate.master import RETRY, Master
from rigel_k8s.gate.nodes import Nodes
from rigel_k8s.gate.parameters import split
from rigel_k8s.gate.registry import (
    PARAMETER,
    PUBLISHER,
    SERVICE,
    SUBSCRIBER,
    Registration,
    host_of,
    resolve_name,
)
from rigel_k8s.gate.restoring import Restoring
from rigel_k8s.gate.state import Event, Newcomer, State, pack

#: Seconds between two looks at nodes that wait for a name and at those that have it.
LOOK = 0.25


class Gate:
    """Answers calls; see the module.

    Args:
        state: what an earlier gate has left, or an empty one.
        uri: the gate's own, which callers take for the master's.
        keep: is told each event before its cause is answered.
        log: is told a line about what a person may want to know.
    """

    def __init__(
        self,
        state: State,
        links: Links,
        uri: str,
        keep: Callable[[Event], None],
        log: Callable[[str], None],
    ) -> None:
        self.state = state
        self._uri = uri
        self._context = Context(state, links, keep, log)
        self._master = Master(self._context)
        self._nodes = Nodes(self._context)
        self._restoring = Restoring(self._context, self._master, self._nodes)
        self._conflicts: deque[dict[str, Any]] = deque(maxlen=20)
        for newcomer in state.newcomers.values():
            newcomer.quiet_since = links.now()

    # -- life --

    def start(self) -> None:
        """Look for the master, and look after newcomers, until stopped."""
        self._master.start(self._restoring.complete_master, self._finish_hand_overs)
        self._context.spawn(self._watch_nodes())

    async def stop(self) -> None:
        """End everything that goes on."""
        await self._context.stop()

    # -- calls --

    async def answer(self, call: Call, *, hands_over: bool, local: bool = False) -> Answer:
        """Return the answer to a call.

        Args:
            hands_over: it came by the door of nodes that hand their names over.
            local: it came from this pod. Such a call does not wait for a master that is away: it
                may be roscore's own, which looks for another one before it starts its own.
        """
        if local and not await self._master.is_there():
            return fault("no ROS master answers behind the gate yet")
        own = {DESCRIBE_POD: self._describe_pod, HAND_OVER: self._hand_over}
        if call.method in own:
            return await own[call.method](call)
        if call.method == "getUri":
            return Answer.good("", self._uri)
        if call.method == DESCRIBE_GATE:
            return Answer.good("", json.dumps(self.describe()))
        if call.method == "system.multicall":
            return await self._answer_many(call, hands_over=hands_over)
        try:
            return await self._answer_change(call, hands_over=hands_over)
        except BadCall:
            return await self._master.ask(call)  # the master has the words for it

    async def _answer_many(self, call: Call, *, hands_over: bool) -> Answer:
        answers: list[Any] = []
        try:
            calls = [Call(one["methodName"], tuple(one["params"])) for one in call.params[0]]
        except (BadCall, LookupError, TypeError):
            return await self._master.ask(call)
        for one in calls:
            answers.append([(await self.answer(one, hands_over=hands_over)).value])
        return Answer(answers)

    async def _answer_change(self, call: Call, *, hands_over: bool) -> Answer:
        one = registration_of(call)
        if one:
            return await self._register(call, one, hands_over=hands_over)
        removal = removal_of(call)
        if removal:
            return await self._unregister(call, removal)
        if call.method == "setParam" and len(call.params) == 3:
            key = resolve_name(call.texts(2)[1], call.texts(2)[0])
            return await self._change_parameter(call, ("set", key, pack(call.params[2])))
        if call.method == "deleteParam":
            node, key = call.texts(2)
            return await self._change_parameter(call, ("delete", resolve_name(key, node)))
        return await self._master.ask(call)

    # -- registrations --

    async def _register(self, call: Call, one: Registration, *, hands_over: bool) -> Answer:
        while True:
            before = self.state.registry.api_of(one.node)
            lives = False
            if before not in (None, one.api):
                lives, there = await asyncio.gather(
                    self._nodes.lives(str(before)), self._nodes.find(one.api)
                )
                if there is False:  # its call has waited, for the master perhaps
                    return fault(f"{one.node} at {one.api} has ended")
            async with self._context.turn:
                if self.state.registry.api_of(one.node) != before:
                    continue
                waits = (one.node, one.api) in self.state.newcomers
                if not waits:
                    owner = find_owner(self.state, one, hands_over=hands_over)
                    waits = lives and owner is not None
                if waits:
                    self._let_wait(one)
                    break
                if self._master.is_ready:
                    if lives:
                        self._note_conflict(one, str(before))
                    await self._nodes.settle(one)
                    answer = await self._master.call(call)
                    if answer.is_success and not self.state.registry.has(one):
                        self._context.note("register", *one, hands_over)
                        self._update_newcomers(one)
                    return answer
            await self._master.until_ready()  # and look again: much may change meanwhile
        return await self._answer_newcomer(one)

    def _let_wait(self, one: Registration) -> None:
        """Note what a newcomer registers; one that has started again in its pod begins anew.

        The same again says nothing new: rospy subscribes to a parameter with each line it logs.
        """
        for other in self.state.newcomers_for(one.node):
            if other.host == one.host and other.api != one.api:
                self._context.note("dismiss", other.name, other.api)
        if (one.node, one.api) not in self.state.newcomers:
            self._context.log(f"{one.node} at {one.api} waits to take over")
        known = self.state.newcomers.get((one.node, one.api))
        if known is None or known.registrations.get((one.kind, one.key)) != one:
            self._context.note("wait", *one)
            self.state.newcomers[one.node, one.api].quiet_since = self._context.links.now()

    async def _answer_newcomer(self, one: Registration) -> Answer:
        """Return what the master would say, but nothing to act upon."""
        if one.kind == PUBLISHER:
            return Answer.good(f"Registered [{one.node}] as publisher of [{one.key}]", [])
        if one.kind == SERVICE:
            return Answer.good(f"Registered [{one.node}] as provider of [{one.key}]", 1)
        if one.kind == SUBSCRIBER:
            known = list_publishers(self.state, one.key) if self._is_warm(one.host) else []
            return Answer.good(f"Subscribed to [{one.key}]", known)
        found = (await self._master.ask(Call("getParam", (one.node, one.key)))).result
        message = f"Subscribed to parameter [{one.key}]"
        return Answer.good(message, {} if found is None else found)

    def _is_warm(self, host: str) -> bool:
        pod = self.state.pods.get(host)
        return pod is not None and pod.warm

    async def _unregister(self, call: Call, removal: Removal) -> Answer:
        self._context.removals.append(removal)
        try:
            return await self._remove(call, removal)
        finally:
            self._context.removals.remove(removal)

    async def _remove(self, call: Call, removal: Removal) -> Answer:
        async with self._context.turn:
            for newcomer in self.state.newcomers_for(removal.node):
                waiting = newcomer.registrations.get((removal.kind, removal.key))
                if waiting and removal.uri in (waiting.api, waiting.detail):
                    self._context.note(
                        "unwait", removal.kind, removal.key, newcomer.name, newcomer.api
                    )
                    newcomer.quiet_since = self._context.links.now()
                    return Answer.good(f"Unregistered [{removal.node}]", 1)
            await self._nodes.settle(removal)
            answer = await self._master.call(call)
            if answer.is_success:
                self._context.note("unregister", *removal)
                self._update_newcomers(removal)
            if self.state.registry.api_of(removal.node) is None:
                self._context.spawn(self._take_over_free(removal.node))
            return answer

    async def _change_parameter(self, call: Call, event: tuple[str, ...]) -> Answer:
        async with self._context.turn:
            answer = await self._master.call(call)
            if answer.is_success:
                self._context.note(*event)
                self._update_parameters(event[1])
            return answer

    async def _visit(self, newcomer: Newcomer) -> None:
        """Find out how it is with a newcomer; one that has ended waits no more.

        One whose machine is away may come back: it never registers again by itself.
        """
        there = await self._nodes.find(newcomer.api)
        newcomer.is_silent = there is None
        if there is False and (newcomer.name, newcomer.api) in self.state.newcomers:
            self._context.log(f"{newcomer.name} at {newcomer.api} has ended before it took over")
            self._context.note("dismiss", newcomer.name, newcomer.api)

    def _note_conflict(self, one: Registration, before: str) -> None:
        """Remember that a node lost its name to a younger one that is no update of it."""
        if host_of(before) in (one.host, *self.state.leaving):
            return
        last = self._conflicts[-1] if self._conflicts else {}
        if (last.get("node"), last.get("new")) != (one.node, one.api):
            self._conflicts.append(
                {"node": one.node, "old": before, "new": one.api, "time": self._context.links.now()}
            )
            self._context.log(f"{one.node} at {before} loses its name to the node at {one.api}")

    # -- what nodes hear from the gate --

    def _update_newcomers(self, changed: Any) -> None:
        """Give a topic's new list of publishers to newcomers that get it early."""
        if changed.kind == PUBLISHER:
            for newcomer in self.state.newcomers.values():
                has = (SUBSCRIBER, changed.key) in newcomer.registrations
                if has and self._is_warm(newcomer.host):
                    self._nodes.send_publishers(newcomer.api, changed.key)

    def _update_parameters(self, key: str) -> None:
        """Give a changed parameter to newcomers that have subscribed to it."""
        changed = split(key)
        for newcomer in self.state.newcomers.values():
            for one in newcomer.registrations.values():
                wanted = split(one.key)
                short = min(len(wanted), len(changed))
                if one.kind == PARAMETER and wanted[:short] == changed[:short]:
                    nearest = key if len(changed) > len(wanted) else one.key
                    self._nodes.send_parameter(newcomer.api, nearest)

    # -- hand-over --

    async def _describe_pod(self, call: Call) -> Answer:
        """Take a pod's description of itself; return its nodes that wait.

        Arguments: caller, pod, workload, "warm" or "", then the addresses of its nodes. Each node
        is returned as [name, URI, "quiet" or "busy", URI of the one that has the name].
        """
        _, pod, workload, warm, *hosts = call.texts(len(call.params))
        found = []
        for host in hosts:
            known = self.state.pods.get(host)
            described = (host, pod, workload, warm == "warm")
            if tuple(known or ()) != described:
                self._context.note("pod", *described)
                self._warm_up(host)
            for newcomer in self.state.newcomers_at(host):
                quiet = "quiet" if is_quiet(newcomer, self._context.links.now()) else "busy"
                owner = self.state.registry.api_of(newcomer.name) or ""
                found.append([newcomer.name, newcomer.api, quiet, owner])
        for stranger in list(find_strangers(self.state)):
            before = self.state.registry.api_of(stranger.name) or ""
            self._note_conflict(next(iter(stranger.registrations.values())), before)
            self._context.spawn(self._take_over(stranger.name, stranger.api, before or None))
        return Answer.good("", found)

    def _warm_up(self, host: str) -> None:
        """Give the newcomers of a pod that has just said so their publishers."""
        if self._is_warm(host):
            for newcomer in self.state.newcomers_at(host):
                for one in newcomer.registrations.values():
                    if one.kind == SUBSCRIBER:
                        self._nodes.send_publishers(one.api, one.key)

    async def _hand_over(self, call: Call) -> Answer:
        """Give the names of a pod that ends to those that wait for them; return these names.

        Arguments: caller, seconds that newcomers have to become quiet, the pod's addresses.
        """
        _, seconds, *hosts = call.texts(len(call.params))
        for host in hosts:
            self._context.note("leave", host)
        deadline = self._context.links.now() + float(seconds)
        names = [name for host in hosts for name in list_names_of(self.state, host)]
        return Answer.good("", [name for name in names if await self._pass_on(name, deadline)])

    async def _pass_on(self, name: str, deadline: float) -> bool:
        """Give a name to who waits for it, once that is quiet; return whether anyone got it."""
        owner = self.state.registry.api_of(name)
        while self.state.registry.api_of(name) == owner:
            heir = choose_heir(self.state, name, self._context.links.now())
            if heir is None:
                return False
            await self._visit(heir)
            if heir is not choose_heir(self.state, name, self._context.links.now()):
                continue
            if is_quiet(heir, self._context.links.now()) or self._context.links.now() >= deadline:
                await self._take_over(heir.name, heir.api, owner)
            else:
                await self._context.links.sleep(RETRY)
        return self.state.registry.api_of(name) is not None

    async def _take_over(self, name: str, api: str, owner: str | None) -> bool:
        """Give a waiting node its name; the master shuts down who had it.

        Args:
            owner: who has the name, as the caller has seen it. Another one may have got it before
                this takes its turn, such as one that has started again in its pod.
        """
        async with self._context.turn:
            newcomer = self.state.newcomers.get((name, api))
            if newcomer is None or self.state.registry.api_of(name) != owner:
                return False
            async with self._master.handing_over():
                await self._pass_registrations(newcomer)
            self._context.note("dismiss", name, api)
        self._context.log(f"{name} at {api} has taken over")
        return True

    async def _pass_registrations(self, newcomer: Newcomer) -> None:
        """Register all that a newcomer has, and send it what the master answers."""
        for one in newcomer.all():
            await self._nodes.settle(one)
            answer = await self._master.call(call_of(one))
            if not answer.is_success:
                self._context.log(
                    f"the master refuses {one.kind} {one.key} of {one.node}: {answer.value}"
                )
                continue
            self._context.note("register", *one, True)
            self._update_newcomers(one)
            self._nodes.send_answer(one)

    async def _take_over_free(self, name: str) -> None:
        """Give a name that no one has any more to who waits for it."""
        heir = choose_heir(self.state, name, self._context.links.now())
        if heir:
            await self._take_over(heir.name, heir.api, None)

    async def _watch_nodes(self) -> None:
        """Look whether newcomers live, and those whose names they wait for."""
        while True:
            await self._context.links.sleep(LOOK)
            try:
                await self._look_around()
            except Exception as error:  # a fault here must not end all hand-overs
                self._context.log(f"error: {error!r}")

    async def _look_around(self) -> None:
        for name in sorted({one.name for one in self.state.newcomers.values()}):
            self._context.spawn_once(name, self._look_at)
        self._nodes.send_again()
        for host in sorted(self.state.leaving):
            if not list_names_of(self.state, host) and not self.state.newcomers_at(host):
                self._context.note("away", host)
        await self._restoring.look_around()

    async def _look_at(self, name: str) -> None:
        await asyncio.gather(*map(self._visit, self.state.newcomers_for(name)))
        owner = self.state.registry.api_of(name)
        heir = choose_heir(self.state, name, self._context.links.now())
        if heir is None:
            return
        free = owner is None or owner == heir.api or not await self._nodes.lives(owner)
        if not free and host_of(str(owner)) in self.state.leaving:
            free = is_quiet(heir, self._context.links.now())
        if free:
            await self._take_over(heir.name, heir.api, owner)

    # -- a master that comes back --

    async def _finish_hand_overs(self) -> None:
        """Finish what an earlier gate had begun when it ended: its nodes have half of it."""
        for newcomer in list(self.state.newcomers.values()):
            if self.state.registry.api_of(newcomer.name) == newcomer.api:
                await self._take_over(newcomer.name, newcomer.api, newcomer.api)

    # -- for people --

    def describe(self) -> dict[str, Any]:
        """Return what `rigel status` shows of the gate."""
        return {
            "waiting": [
                {"node": one.name, "api": one.api, "owner": self.state.registry.api_of(one.name)}
                for one in self.state.newcomers.values()
            ],
            "conflicts": [
                {**one, "time": self._context.links.now() - one["time"]} for one in self._conflicts
            ],
            "silent": sorted(self.state.silent),
            "restarts": self._restoring.restarts,
            "nodes": len(self.state.registry.nodes),
        }
