"""The answers of a ROS 1 master and its nodes, all asked at once.

It compares nothing and keeps nothing; ros1.py does.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from rigel_exporter.ros1_calls import Conversation, Refused
from rigel_inpod import rosrpc
from rigel_inpod.rosrpc import CallFailed

#: Seconds that the master has for one round of answers, and a node for all its answers.
MASTER, ANSWER = 5.0, 3.0

Names = Mapping[str, frozenset[str]]


class View(NamedTuple):
    """The master's state: topic or service -> names of nodes; topic -> type."""

    pid: int
    run: str
    publishers: Names
    subscribers: Names
    services: Names
    types: Mapping[str, str]
    local_address: str = ""

    @property
    def nodes(self) -> set[str]:
        """The names of all nodes that have registered anything."""
        parts = (self.publishers, self.subscribers, self.services)
        return {name for part in parts for names in part.values() for name in names}


class Replies:
    """A node's answers; those that it did not give in time stay empty."""

    def __init__(self) -> None:
        self.pid = ""
        self.stats: Any = None
        self.publishes: set[str] = set()
        self.subscribes: set[str] = set()

    @property
    def answers(self) -> bool:
        """Whether it gave any answer."""
        return bool(self.pid)


async def ask_master(uri: str, caller: str) -> View:
    """Return the master's state; a failed call is tried again, since a packet may be lost.

    Raises:
        CallFailed: it does not answer.
    """
    try:
        return await _ask_master(uri, caller)
    except CallFailed:
        return await _ask_master(uri, caller)


async def _ask_master(uri: str, caller: str) -> View:
    talk = Conversation(uri, caller, MASTER, rosrpc.LARGEST)
    try:
        pid = int(await talk.call("getPid"))
        state = await talk.call("getSystemState")
        types = dict(await talk.call("getTopicTypes"))
        run = await _parameter(talk, "/run_id")
        publishers, subscribers, services = map(_names, state)
        here = talk.local_address or ""
        return View(pid, run, publishers, subscribers, services, types, here)
    except (ValueError, TypeError) as error:
        raise CallFailed(f"it does not speak ROS: {error}") from error
    finally:
        talk.close()


def _names(part: Sequence[tuple[str, Sequence[str]]]) -> Names:
    return {name: frozenset(nodes) for name, nodes in part}


async def _parameter(talk: Conversation, name: str) -> str:
    try:
        return str(await talk.call("getParam", name))
    except Refused:
        return ""


async def look_up_nodes(uri: str, caller: str, names: Iterable[str]) -> dict[str, str]:
    """Return the URIs of the nodes that are registered, as far as the master answers in time."""
    talk, found = Conversation(uri, caller, MASTER, rosrpc.LARGEST), {}
    try:
        for name in names:
            try:
                found[name] = str(await talk.call("lookupNode", name))
            except Refused:
                continue
    except CallFailed:
        pass
    finally:
        talk.close()
    return found


async def ask_nodes(uris: Mapping[str, str], caller: str) -> dict[str, Replies]:
    """Return each node's answers; all are asked at once, each has its own deadline."""
    answers = await asyncio.gather(*(_ask_node(uri, caller) for uri in uris.values()))
    return dict(zip(uris, answers))


async def _ask_node(uri: str, caller: str) -> Replies:
    replies = Replies()
    try:
        talk = Conversation(uri, caller, ANSWER)
    except CallFailed:
        return replies
    try:
        replies.pid = str(await talk.call("getPid"))
        replies.publishes = _topics(await talk.call("getPublications"))
        replies.subscribes = _topics(await talk.call("getSubscriptions"))
        replies.stats = await talk.call("getBusStats")  # rospy fails beyond 2 GiB: the last
    except CallFailed:
        pass
    finally:
        talk.close()
    return replies


def _topics(value: Any) -> set[str]:
    """Return the topics of a node's answer, [[topic, type], ...]; raises CallFailed for another."""
    try:
        return {str(name) for name, _ in value}
    except (TypeError, ValueError) as error:
        raise CallFailed("it does not speak ROS") from error
