"""The server of `rigel ui` without a cluster: a test fills its feed."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import attrs

from rigel_k8s.commands.logs.lines import LogLine
from rigel_ui.boxes import describe
from rigel_ui.feed import Changes, Feed, Rollback
from rigel_ui.logs import LogHub, Read
from rigel_ui.nodes import STATES
from rigel_ui.readings import Read as ReadOnce
from rigel_ui.readings import Readings
from rigel_ui.server import PageServer

TOKEN = "a-token-of-the-tests"


@attrs.frozen
class Answer:
    """What a server has answered."""

    status: int
    headers: Mapping[str, str]
    body: bytes


@attrs.frozen
class Served:
    """A running server."""

    feed: Feed
    logs: LogHub
    port: int
    tickets: Any
    changes: Changes | None

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    @property
    def address(self) -> str:
        return f"http://{self.host}/{TOKEN}/"

    def ask(
        self,
        path: str = f"/{TOKEN}/",
        method: str = "GET",
        body: bytes | None = None,
        **headers: str,
    ) -> Answer:
        """Send a request; `host="x"` and `origin="y"` are headers."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        own = {"Host": self.host, **{k.replace("_", "-").title(): v for k, v in headers.items()}}
        connection.request(method, path, body=body, headers=own)
        answer = connection.getresponse()
        found = Answer(answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read())
        connection.close()
        return found

    def connect(self, words: str = "") -> Stream:
        """Open a page's stream, `words` behind its path."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        connection.request("GET", f"/{TOKEN}/live{words}", headers={"Host": self.host})
        return Stream(connection, connection.getresponse())


@attrs.frozen
class Stream:
    """A page's stream of messages."""

    connection: http.client.HTTPConnection
    answer: http.client.HTTPResponse

    def receive(self) -> Any:
        """Return the next message."""
        while line := self.answer.readline():
            if line.startswith(b"data: "):
                return json.loads(line[6:])
        raise EOFError

    def close(self) -> None:
        self.answer.close()
        self.connection.close()


def read_nothing(node: str, cancel: threading.Event) -> Iterator[LogLine]:
    """A log without lines."""
    cancel.wait()
    yield from ()


@contextmanager
def serve_page(
    read: Read = read_nothing,
    rollback: Rollback | None = None,
    port: int = 0,
    kinds: Mapping[str, ReadOnce] | None = None,
) -> Iterator[Served]:
    """Run a server; `kinds` read a message or parameters."""
    feed, logs = Feed(), LogHub(read)
    changes = None if rollback is None else Changes(feed, rollback)
    server = PageServer(port, feed, logs, TOKEN, changes, Readings(kinds or {}))
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield Served(feed, logs, server.port, server.tickets, changes)
    finally:
        logs.close()
        if changes:
            changes.close()
        server.close()
        thread.join(60)
        assert not thread.is_alive()


def node(
    name: str, state: str = "ready", machine: str = "robot", cause: str = "", **more: Any
) -> dict[str, Any]:
    """Return a node's entry."""
    workload = name.strip("/").replace("/", "-").replace("_", "-")
    pod = {
        "name": f"{workload}-5d4f",
        "node": machine,
        "phase": "Running",
        "ready": state == "ready",
        "restarts": 0,
        "created": "2026-01-01T00:00:00Z",
        "ip": "10.0.0.1",
        "image": "robot:1",
        "message": "",
    }
    return {
        "name": name,
        "workload": workload,
        "kind": "Deployment",
        "helper": False,
        "state": state,
        "cause": cause,
        "brief": cause,
        "remedy": "",
        "ready": int(state == "ready"),
        "desired": 1,
        "machine": machine,
        "image": "registry.example/robot:1.4",
        "restarts": 0,
        "pods": [pod],
        **more,
    }


def topic(name: str, publishers: Sequence[str], subscribers: Sequence[str]) -> dict[str, Any]:
    """Return a topic's entry."""
    return {
        "name": name,
        "type": "std_msgs/msg/String",
        "rate": "10.0/s",
        "bad": False,
        "from": list(publishers),
        "to": list(subscribers),
        "lost": [],
    }


def measure(feed: Feed, topic: str, rates: Mapping[float, float | None]) -> None:
    """Publish rates of a topic by the seconds at which the graph was read; None is a gap."""
    feed.publish(
        "rates",
        {
            f"rates/{begun}": {
                "begun": begun,
                "ended": begun + 25,
                "of": {} if rate is None else {topic: rate},
            }
            for begun, rate in rates.items()
        },
    )


def fill(
    feed: Feed,
    nodes: Sequence[Mapping[str, Any]],
    topics: Sequence[Mapping[str, Any]] = (),
    *,
    changes: bool = False,
) -> None:
    """Publish a release of some nodes."""
    place = {"server": "https://lab", "context": "lab", "release": "demo", "namespace": "n"}
    feed.publish("cluster", {"cluster": {**place, "message": "", "since": ""}})
    feed.publish("server", {"server": {"changes": changes}})
    feed.publish("node", {f"node/{one['workload']}": one for one in nodes})
    boxes = [
        {
            "name": n["name"],
            "workload": n["workload"],
            "machine": n["machine"],
            "note": "",
            "wrong": "",
            "services": [],
        }
        for n in nodes
    ]
    feed.publish("box", {f"box/{box['name']}": box for box in boxes})
    shown = {f"topic/{one['name']}": one for one in topics}
    feed.publish("topic", shown)
    text = describe({box["name"]: box for box in boxes}, shown)
    feed.publish("dot", {"dot": {"text": text}})
    counts = {state: sum(n["state"] == state for n in nodes) for state in STATES}
    whole = {"revision": 2, "status": "good", "changing": "", "counts": counts}
    ready = counts["ready"]
    feed.publish(
        "release", {"release": {**whole, "nodes": len(nodes), "ready": ready, "well": True}}
    )
    feed.publish("graph", {"graph": {"message": "", "read": "2026-01-01T00:00:00Z"}})
