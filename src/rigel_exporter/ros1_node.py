"""The exporter as a ROS 1 node: the few calls that masters and other nodes make to one.

It is only needed for named topics: the master calls it when a topic's publishers change.
"""

from __future__ import annotations

import os
import socketserver
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

Answer = tuple[int, str, Any]

#: The answers that are always the same: it publishes nothing and counts nothing. It stays when the
#: master has given its name to another node, since Kubernetes ends pods, not the ROS master.
_CONSTANT = {
    "getPid": os.getpid(),
    "getPublications": [],
    "getBusStats": [[], [], []],
    "getBusInfo": [],
    "paramUpdate": 0,
    "shutdown": 0,
}


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
        self._topics, self._changed = topics, changed
        self._server = _Server(("", 0), _Handler, logRequests=False, allow_none=True)
        self.port: int = self._server.server_address[1]
        for name, value in {**_CONSTANT, "getMasterUri": master_uri}.items():
            self._server.register_function(partial(_answer, value), name)
        self._server.register_function(self._list_topics, "getSubscriptions")
        self._server.register_function(self._take_publishers, "publisherUpdate")
        self._server.register_function(self._refuse_topic, "requestTopic")
        threading.Thread(target=self._server.serve_forever, name="slave", daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()

    # The first argument of each call is the caller's name.

    def _list_topics(self, _: Any) -> Answer:
        return 1, "", [[topic, "*"] for topic in self._topics()]

    def _take_publishers(self, _: Any, topic: Any, publishers: Any) -> Answer:
        self._changed(topic, publishers)
        return 1, "", 0

    def _refuse_topic(self, _: Any, topic: Any, protocols: Any) -> Answer:
        return 0, f"{topic} is not published here", []


def _answer(value: Any, *_: Any) -> Answer:
    return 1, "", value
