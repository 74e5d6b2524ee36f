"""The exporter as a ROS 1 node: the few calls that masters and other nodes make to one.

It is only needed for named topics: the master calls it when a topic's publishers change.
"""

from __future__ import annotations

import os
import socketserver
import threading
from collections.abc import Callable, Sequence
from typing import Any
from xmlrpc.server import SimpleXMLRPCDispatcher, SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

Answer = tuple[int, str, Any]


class _Handler(SimpleXMLRPCRequestHandler):
    rpc_paths = ()  # masters post to / or to /RPC2
    timeout = 30


class _Server(socketserver.ThreadingMixIn, SimpleXMLRPCServer):
    daemon_threads = True


class Slave:
    """A slave API on a free port of all addresses."""

    def __init__(
        self,
        master_uri: str,
        topics: Callable[[], Sequence[str]],
        changed: Callable[[str, Sequence[str]], None],
    ) -> None:
        """Serve from now on.

        Args:
            master_uri: the answer to getMasterUri.
            topics: returns the topics that are subscribed to now.
            changed: is called with a topic and its publishers' URIs.
        """
        self._master_uri, self._topics, self._changed = master_uri, topics, changed
        self._server = _Server(("", 0), _Handler, logRequests=False, allow_none=True)
        self.port: int = self._server.server_address[1]
        _offer(self._server, self)
        threading.Thread(target=self._server.serve_forever, name="slave", daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()

    # ROS's names; the first argument is the caller's

    def getPid(self, _: str) -> Answer:
        """Return the process id."""
        return 1, "", os.getpid()

    def getMasterUri(self, _: str) -> Answer:
        """Return the master's URI."""
        return 1, "", self._master_uri

    def getPublications(self, _: str) -> Answer:
        """Return what is published: nothing."""
        return 1, "", []

    def getSubscriptions(self, _: str) -> Answer:
        """Return the named topics."""
        return 1, "", [[topic, "*"] for topic in self._topics()]

    def getBusStats(self, _: str) -> Answer:
        """Return no counts."""
        return 1, "", [[], [], []]

    def getBusInfo(self, _: str) -> Answer:
        """Return no connections."""
        return 1, "", []

    def publisherUpdate(self, _: str, topic: str, publishers: Sequence[str]) -> Answer:
        """Take a topic's publishers from the master."""
        self._changed(topic, publishers)
        return 1, "", 0

    def paramUpdate(self, _: str, key: str, value: Any) -> Answer:
        """Ignore parameters."""
        return 1, "", 0

    def requestTopic(self, _: str, topic: str, protocols: Any) -> Answer:
        """Refuse: nothing is published."""
        return 0, f"{topic} is not published here", []

    def shutdown(self, _: str, reason: str = "") -> Answer:
        """Ignore that another node took the name: Kubernetes ends pods, not the ROS master."""
        return 1, "", 0


def _offer(dispatcher: SimpleXMLRPCDispatcher, slave: Slave) -> None:
    for name in (
        "getPid",
        "getMasterUri",
        "getPublications",
        "getSubscriptions",
        "getBusStats",
        "getBusInfo",
        "publisherUpdate",
        "paramUpdate",
        "requestTopic",
        "shutdown",
    ):
        dispatcher.register_function(getattr(slave, name), name)
