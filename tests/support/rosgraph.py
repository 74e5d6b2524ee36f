"""A ROS 1 graph of threads: a master and nodes that speak XML-RPC and TCPROS on the loopback.

It is for tests of what asks and hears a graph; tests/ros1 shows that roscore and rospy do the same.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from socketserver import ThreadingMixIn
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

from .until import until as wait_until

Answer = list[Any]


class _Handler(SimpleXMLRPCRequestHandler):
    protocol_version = "HTTP/1.1"  # keeps connections, as rosmaster does

    def log_message(self, format: str, *args: object) -> None:
        pass


class _Server(ThreadingMixIn, SimpleXMLRPCServer):
    daemon_threads = True
    block_on_close = False


class Rpc:
    """An XML-RPC server of this object's public methods."""

    def __init__(self) -> None:
        self._server = _Server(("127.0.0.1", 0), requestHandler=_Handler)
        self._server.register_instance(self)
        self.port: int = self._server.server_address[1]
        self.uri = f"http://127.0.0.1:{self.port}/"
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.01,), daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Answer no new connection; again is harmless."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
            self._server.server_close()


class Master(Rpc):
    """A rosmaster.

    Attributes:
        nodes: name -> URI, as lookupNode tells; what is left here after a node has gone is told.
        publishers, subscribers, services: topic or service -> names of nodes.
        calls: (method, arguments) of all that registers or takes leave.
    """

    def __init__(self) -> None:
        self.pid, self.parameters = 1, {"/run_id": "run-1"}
        self.nodes: dict[str, str] = {}
        self.publishers: dict[str, list[str]] = {}
        self.subscribers: dict[str, list[str]] = {}
        self.services: dict[str, list[str]] = {}
        self.types: dict[str, str] = {}
        self.calls: list[tuple[str, tuple[str, ...]]] = []
        super().__init__()

    def add(
        self, name: str, uri: str, publishes: Sequence[str] = (), subscribes: Sequence[str] = ()
    ) -> None:
        """Register a node, as it does itself."""
        self.nodes[name] = uri
        for topics, table in ((publishes, self.publishers), (subscribes, self.subscribers)):
            for topic in topics:
                table.setdefault(topic, []).append(name)

    def drop(self, name: str) -> None:
        """Take a node's topics away and keep its name, as where it had subscribed to parameters."""
        for table in (self.publishers, self.subscribers, self.services):
            for topic in list(table):
                table[topic] = [other for other in table[topic] if other != name]
                if not table[topic]:
                    del table[topic]

    def getPid(self, caller: str) -> Answer:
        return [1, "", self.pid]

    def lookupNode(self, caller: str, name: str) -> Answer:
        return [1, "", self.nodes[name]] if name in self.nodes else [-1, "unknown node", ""]

    def getSystemState(self, caller: str) -> Answer:
        parts = (self.publishers, self.subscribers, self.services)
        return [1, "", [[[topic, names] for topic, names in part.items()] for part in parts]]

    def getTopicTypes(self, caller: str) -> Answer:
        return [1, "", [list(pair) for pair in self.types.items()]]

    def getParam(self, caller: str, key: str) -> Answer:
        known = key in self.parameters
        return [1, "", self.parameters[key]] if known else [-1, "is not set", 0]

    def getParamNames(self, caller: str) -> Answer:
        return [1, "", list(self.parameters)]

    def hasParam(self, caller: str, key: str) -> Answer:
        return [1, "", key in self.parameters]

    def registerSubscriber(self, caller: str, topic: str, kind: str, uri: str) -> Answer:
        self.calls.append(("registerSubscriber", (caller, topic, kind, uri)))
        self.add(caller, uri, subscribes=[topic])
        return [1, "", [self.nodes[name] for name in self.publishers.get(topic, [])]]

    def unregisterSubscriber(self, caller: str, topic: str, uri: str) -> Answer:
        self.calls.append(("unregisterSubscriber", (caller, topic, uri)))
        self.subscribers[topic].remove(caller)
        return [1, "", 1]


class Node(Rpc):
    """A node's own servers: what it says of itself, and its topics by TCPROS.

    Attributes:
        links: topic -> how many subscribers are connected.
    """

    def __init__(
        self,
        publishes: Sequence[str] = (),
        subscribes: Sequence[str] = (),
        *,
        pid: int = 7,
        stats: Answer | None = None,
        fields: Mapping[str, str] | None = None,
    ) -> None:
        """`fields` are the connection header's of each topic, beside what all have."""
        self.publishes, self.subscribes = list(publishes), list(subscribes)
        self.pid, self.stats = pid, stats if stats is not None else [[], [], []]
        self.fields = {"message_definition": "string data", **(fields or {})}
        self._changed = threading.Condition()
        self._links: dict[str, list[socket.socket]] = {}
        self._topics = socket.create_server(("127.0.0.1", 0))
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()
        super().__init__()

    def close(self) -> None:
        """End, with all its connections."""
        super().close()
        with suppress(OSError):
            self._topics.shutdown(socket.SHUT_RDWR)
        self._accepting.join()
        self._topics.close()
        with self._changed:
            for link in [link for links in self._links.values() for link in links]:
                link.close()
            self._links.clear()

    @property
    def links(self) -> dict[str, int]:
        with self._changed:
            return {topic: len(links) for topic, links in self._links.items()}

    def publish(self, topic: str, payload: bytes) -> int:
        """Send a message to all who are connected; return to how many it went."""
        sent = 0
        with self._changed:
            for link in self._links.get(topic, ()):
                with suppress(OSError):
                    link.sendall(struct.pack("<I", len(payload)) + payload)
                    sent += 1
        return sent

    def wait_for_subscriber(self, topic: str, seconds: float = 30) -> None:
        """Wait until a subscriber is connected."""
        with self._changed:
            assert self._changed.wait_for(lambda: self._links.get(topic), seconds), topic

    def hang_up(self, topic: str) -> None:
        """End the connections of a topic; who wants it may come back."""
        with self._changed:
            for link in self._links.pop(topic, []):
                link.close()

    def wait_for_end(self, topic: str, seconds: float = 30) -> bool:
        """Wait until the subscribers of a topic have closed their connections."""
        for link in self._links.get(topic, []):
            link.settimeout(seconds)
            try:
                if link.recv(1):
                    return False
            except ConnectionError:
                continue
            except TimeoutError:
                return False
        return True

    def getPid(self, caller: str) -> Answer:
        return [1, "", self.pid]

    def getPublications(self, caller: str) -> Answer:
        return [1, "", [[topic, "std_msgs/String"] for topic in self.publishes]]

    def getSubscriptions(self, caller: str) -> Answer:
        return [1, "", [[topic, "std_msgs/String"] for topic in self.subscribes]]

    def getBusStats(self, caller: str) -> Answer:
        return [1, "", self.stats]

    def requestTopic(self, caller: str, topic: str, protocols: Answer) -> Answer:
        if topic not in self.publishes:
            return [-1, "not a publisher", 0]
        return [1, "", ["TCPROS", "127.0.0.1", self._topics.getsockname()[1]]]

    def _accept(self) -> None:
        while True:
            try:
                link, _ = self._topics.accept()
            except OSError:
                return
            fields = _header(link)
            link.sendall(_encode({"callerid": "/node", "md5sum": "*", **self.fields}))
            with self._changed:
                self._links.setdefault(fields.get("topic", ""), []).append(link)
                self._changed.notify_all()


def _header(link: socket.socket) -> dict[str, str]:
    data, at, found = _read_exactly(link, *struct.unpack("<I", _read_exactly(link, 4))), 0, {}
    while at < len(data):
        (size,) = struct.unpack_from("<I", data, at)
        key, _, value = data[at + 4 : at + 4 + size].decode().partition("=")
        found[key] = value
        at += 4 + size
    return found


def _encode(fields: Mapping[str, str]) -> bytes:
    lines = [f"{key}={value}".encode() for key, value in fields.items()]
    body = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    return struct.pack("<I", len(body)) + body


def _read_exactly(link: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        got = link.recv(size - len(data))
        if not got:
            break
        data += got
    return data


class RosGraph:
    """A master and its nodes; everything ends with `ros_graph`."""

    def __init__(self, cleanup: ExitStack) -> None:
        self._cleanup = cleanup
        self.master = self._keep(Master())

    def node(self, name: str, publishes: Sequence[str] = (), **more: Any) -> Node:
        """Start a node that is registered with all its topics."""
        node = self.program(publishes, **more)
        self.master.add(name, node.uri, publishes, node.subscribes)
        return node

    def program(self, publishes: Sequence[str] = (), **more: Any) -> Node:
        """Start a node that the master knows nothing of."""
        node: Node = self._keep(Node(publishes, **more))
        return node

    def serve_silence(self) -> str:
        """Return the URI of someone who accepts connections and never says a word."""
        server = self._cleanup.enter_context(socket.create_server(("127.0.0.1", 0)))
        return f"http://127.0.0.1:{server.getsockname()[1]}/"

    def _keep(self, server: Any) -> Any:
        self._cleanup.callback(server.close)
        return server


@contextmanager
def ros_graph() -> Iterator[RosGraph]:
    """Make a graph with an empty master."""
    with ExitStack() as cleanup:
        yield RosGraph(cleanup)


def until(condition: Callable[[], object], what: str, seconds: float = 60) -> None:
    """Wait until a condition holds; looks oftener than others, since all is on this machine."""
    wait_until(condition, what, seconds, every=0.01)
