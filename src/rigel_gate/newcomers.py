"""Nodes that wait for a name: what they have registered, are answered and receive meanwhile.

A newcomer must believe that it is registered, and must not act before it has its name. takeover.py
decides when it gets the name.
"""

from __future__ import annotations

from rigel_gate.calls import Answer, Call, Removal
from rigel_gate.context import Context
from rigel_gate.handover import has_bond, list_heard
from rigel_gate.master import Master
from rigel_gate.nodes import Nodes
from rigel_gate.parameters import split
from rigel_gate.registry import PARAMETER, PUBLISHER, SERVICE, SUBSCRIBER, Registration
from rigel_gate.state import Newcomer


class Newcomers:
    """All nodes that wait; an earlier gate's still wait, and count as busy at first."""

    def __init__(self, context: Context, master: Master, nodes: Nodes) -> None:
        self._context = context
        self._state = context.state
        self._master = master
        self._nodes = nodes
        for newcomer in self._state.newcomers.values():
            newcomer.quiet_since = context.links.now()

    # -- what they register --

    def wait(self, one: Registration) -> None:
        """Note what a newcomer registers; if it starts again in its pod, it replaces the first one.

        The same registration again changes nothing: rospy subscribes to a parameter with each line
        that it logs.
        """
        for other in self._state.newcomers_for(one.node):
            if other.host == one.host and other.api != one.api:
                self._context.note("dismiss", other.name, other.api)
        if (one.node, one.api) not in self._state.newcomers:
            self._context.log(f"{one.node} at {one.api} waits to take over")
        known = self._state.newcomers.get((one.node, one.api))
        if known is None or known.registrations.get((one.kind, one.key)) != one:
            self._context.note("wait", *one)
            self._state.newcomers[one.node, one.api].quiet_since = self._context.links.now()
            self._send_bonds(one.kind, one.key, one.host)

    def take_back(self, removal: Removal) -> bool:
        """Note that a newcomer unregisters something; return False if none has registered it."""
        for newcomer in self._state.newcomers_for(removal.node):
            waiting = newcomer.registrations.get((removal.kind, removal.key))
            if waiting and removal.uri in (waiting.api, waiting.detail):
                self._context.note("unwait", removal.kind, removal.key, newcomer.name, newcomer.api)
                newcomer.quiet_since = self._context.links.now()
                self._send_bonds(removal.kind, removal.key, newcomer.host)
                return True
        return False

    async def visit(self, newcomer: Newcomer) -> None:
        """Check whether a newcomer lives; one that has ended no longer waits.

        If its machine is unreachable it may return, and never registers again: it still waits.
        """
        is_alive = await self._nodes.find(newcomer.api)
        newcomer.is_silent = is_alive is None
        if is_alive is False and (newcomer.name, newcomer.api) in self._state.newcomers:
            self._context.log(f"{newcomer.name} at {newcomer.api} has ended before it took over")
            self._context.note("dismiss", newcomer.name, newcomer.api)

    # -- what they are answered and receive --

    async def answer(self, one: Registration) -> Answer:
        """Return what the master would answer, but nothing that makes the node act."""
        if one.kind == PUBLISHER:
            return Answer.good(f"Registered [{one.node}] as publisher of [{one.key}]", [])
        if one.kind == SERVICE:
            return Answer.good(f"Registered [{one.node}] as provider of [{one.key}]", 1)
        if one.kind == SUBSCRIBER:
            known = list_heard(self._state, one.key, one.api)
            return Answer.good(f"Subscribed to [{one.key}]", known)
        found = (await self._master.ask(Call("getParam", (one.node, one.key)))).result
        message = f"Subscribed to parameter [{one.key}]"
        return Answer.good(message, {} if found is None else found)

    def send_parameter(self, key: str) -> None:
        """Send a changed parameter to newcomers that have subscribed to it."""
        changed = split(key)
        for newcomer in self._state.newcomers.values():
            for one in newcomer.registrations.values():
                wanted = split(one.key)
                short = min(len(wanted), len(changed))
                if one.kind == PARAMETER and wanted[:short] == changed[:short]:
                    nearest = key if len(changed) > len(wanted) else one.key
                    self._nodes.send_parameter(newcomer.api, nearest)

    def _send_bonds(self, kind: str, topic: str, host: str) -> None:
        """Send the newcomers of a pod the other ends of their bonds, if these have changed."""
        if kind == PUBLISHER:
            for newcomer in self._state.newcomers_at(host):
                if has_bond(newcomer, topic):
                    self._nodes.send_publishers(newcomer.api, topic)
