"""The answers of a ROS 1 master and its nodes, all asked at once.

It compares nothing and keeps nothing; ros1.py does.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from functools import partial
from typing import Any, NamedTuple

from rigel_inpod import rosrpc
from rigel_inpod.rosrpc import Api, CallFailed, Refused

#: Seconds that the master has for one round of answers, and a node for all its answers.
MASTER, ANSWER = 5.0, 3.0
#: How many nodes are asked at the same time: a stopped one delays no other.
AT_ONCE = 200

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


def connect_master(uri: str, caller: str) -> Any:
    """Return a client of the master, with its time for one round of answers."""
    return closing(Api(uri, time.time() + MASTER, caller))


def connect_node(uri: str, caller: str, seconds: float) -> Any:
    """Return a client of a node, with its time for all answers."""
    return closing(Api(uri, time.time() + seconds, caller, rosrpc.LARGEST_OF_NODE))


def ask_master(uri: str, caller: str) -> View:
    """Return the master's state; a failed call is tried again, since a packet may be lost.

    Raises:
        CallFailed: it does not answer.
    """
    try:
        return _ask_master(uri, caller)
    except CallFailed:
        return _ask_master(uri, caller)


def _ask_master(uri: str, caller: str) -> View:
    with connect_master(uri, caller) as master:
        try:
            pid = int(master.ask("getPid"))
            state = master.ask("getSystemState")
            types = dict(master.ask("getTopicTypes"))
            run = ""
            with suppress(Refused):  # it is not set yet
                run = str(master.ask("getParam", "/run_id"))
            publishers, subscribers, services = map(_names, state)
            here = master.local_address() or ""
            return View(pid, run, publishers, subscribers, services, types, here)
        except (ValueError, TypeError) as error:
            raise CallFailed(f"it does not speak ROS: {error}") from error


def _names(part: Sequence[tuple[str, Sequence[str]]]) -> Names:
    return {name: frozenset(nodes) for name, nodes in part}


def look_up_nodes(uri: str, caller: str, names: Iterable[str]) -> dict[str, str]:
    """Return the URIs of the nodes that are registered, as far as the master answers in time."""
    found = {}
    with suppress(CallFailed), connect_master(uri, caller) as master:
        for name in names:
            with suppress(Refused):
                found[name] = str(master.ask("lookupNode", name))
    return found


def ask_nodes(uris: Mapping[str, str], caller: str) -> dict[str, Replies]:
    """Return each node's answers; many are asked at once, and each has its own deadline."""
    with ThreadPoolExecutor(AT_ONCE, thread_name_prefix="ros1") as pool:
        return dict(zip(uris, pool.map(partial(_ask_node, caller=caller), uris.values())))


def _ask_node(uri: str, caller: str) -> Replies:
    replies = Replies()
    with suppress(CallFailed), connect_node(uri, caller, ANSWER) as node:
        replies.pid = str(node.ask("getPid"))
        replies.publishes = _topics(node.ask("getPublications"))
        replies.subscribes = _topics(node.ask("getSubscriptions"))
        replies.stats = node.ask("getBusStats")  # rospy fails beyond 2 GiB: the last
    return replies


def _topics(value: Any) -> set[str]:
    """Return the topics of a node's answer, [[topic, type], ...]; raises CallFailed for another."""
    try:
        return {str(name) for name, _ in value}
    except (TypeError, ValueError) as error:
        raise CallFailed("it does not speak ROS") from error
