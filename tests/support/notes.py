"""What a pod's keeper answers, as JSON: the notes of processes that tests write down."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from rigel_inpod.rmw_notes import Entity, Process

#: "Now", ns of the machine's clock.
NOW = 100_000_000_000
SECOND = 1_000_000_000
STRING = "std_msgs/msg/String"

Answer = dict[str, Any]


def entity(kind: str, name: str, node: str = "", **fields: Any) -> dict[str, Any]:
    """A part of a node, or an executor."""
    zero = dict.fromkeys(Entity._fields, 0)
    kept = {"type": "", "created": 1, "last": NOW}
    one = Entity(**{**zero, **kept, "kind": kind, "name": name, "node": node, **fields})
    return one._asdict()


def process(*nodes: str, parts: Any = (), pid: int = 7, **fields: Any) -> dict[str, Any]:
    """A process with nodes and their parts, whose executor waits for work."""
    own = [entity("node", name) for name in nodes]
    entities = [*own, *parts, entity("executor", "")]
    made = Process(
        pid=pid,
        full=0,
        ended=False,
        mode=0,
        seen=tuple(nodes),
        entities=(),
        helper=False,
        stands=0,
        goals=(),
    )
    return {**made._asdict(), "entities": entities, **fields}


def answer(*processes: Mapping[str, Any], now: int = NOW) -> Answer:
    """What a keeper answers; after JSON, as its reader gets it."""
    made: Answer = json.loads(json.dumps({"now": now, "processes": processes}))
    return made


def publisher(node: str, topic: str, count: int = 0, **fields: Any) -> dict[str, Any]:
    """A publisher of strings."""
    return entity("publisher", topic, node, **{"type": STRING, "count": count, **fields})


def subscription(node: str, topic: str, count: int = 0, **fields: Any) -> dict[str, Any]:
    """A subscription to strings."""
    return entity("subscription", topic, node, **{"type": STRING, "count": count, **fields})


@contextmanager
def serve(found: Answer) -> Iterator[int]:
    """A keeper that answers so, at 127.0.0.1; its port."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = json.dumps(found).encode()
            self.send_response(200 if self.path == "/notes" else 404)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Log nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()
