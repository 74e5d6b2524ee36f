"""Debian's mosquitto on a free port, with a client that says what was answered."""

from __future__ import annotations

import queue
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client, MQTTMessage, MQTTProtocolVersion, MQTTv5
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from .until import until

PROGRAM = "/usr/sbin/mosquitto"


class Mosquitto:
    """A broker that keeps its sessions on disk.

    Args:
        lines: more of its configuration; {directory} is its directory.
    """

    def __init__(self, directory: Path, *lines: str) -> None:
        self.directory = directory
        self.port = find_port()
        self._process: subprocess.Popen[bytes] | None = None
        config = [
            f"listener {self.port} 127.0.0.1",
            "allow_anonymous true",
            "user root",
            "persistence true",
            f"persistence_location {directory}/",
            "autosave_interval 0",  # only when `save` asks for it, and at its end
            *lines,
        ]
        (directory / "mosquitto.conf").write_text("\n".join(config) + "\n")

    def start(self) -> None:
        """Start it, on the port that it always has."""
        with (self.directory / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [PROGRAM, "-c", self.directory / "mosquitto.conf"], stdout=log, stderr=log
            )
        until(self._is_open, "mosquitto", every=0.02, last_words=self.read_log)

    def kill(self) -> None:
        """End it at once, as a machine that loses its power."""
        if self._process:
            self._process.send_signal(signal.SIGKILL)
            self._process.wait()

    def freeze(self) -> None:
        """Let it do nothing at all: its connections stay open, as behind a cut cable."""
        assert self._process
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        assert self._process
        self._process.send_signal(signal.SIGCONT)

    def save(self, text: bytes) -> None:
        """Let it write what it has to disk, with this text in it."""
        stored = self.directory / "mosquitto.db"

        def is_stored() -> bool:
            assert self._process
            self._process.send_signal(signal.SIGUSR1)
            return stored.exists() and text in stored.read_bytes()

        until(is_stored, f"{text!r} on disk", every=0.05)

    def read_log(self) -> str:
        return (self.directory / "log").read_text()

    def _is_open(self) -> bool:
        assert self._process
        assert self._process.poll() is None, self.read_log()
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


@contextmanager
def running(directory: Path, *lines: str) -> Iterator[Mosquitto]:
    """A broker until the end of the block."""
    broker = Mosquitto(directory, *lines)
    try:
        broker.start()
        yield broker
    finally:
        broker.kill()


def find_port() -> int:
    """Return a port that no one uses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class Peer:
    """A client that sends commands and keeps what it receives.

    Args:
        options: how it connects: username, password, context; `session` is the name of one that
            the broker keeps for it.
        version: MQTT's; Symphony's provider speaks 3.1.1.
    """

    def __init__(
        self, port: int, *topics: str, version: MQTTProtocolVersion = MQTTv5, **options: Any
    ) -> None:
        self.received: queue.SimpleQueue[MQTTMessage] = queue.SimpleQueue()
        session = options.get("session", "")
        self._client = Client(CallbackAPIVersion.VERSION2, session, protocol=version)
        self._client.reconnect_delay_set(max_delay=1)
        received = self.received  # a cycle would keep the client's sockets open
        self._client.on_message = lambda _client, _data, message: received.put(message)
        if "username" in options:
            self._client.username_pw_set(options["username"], options["password"])
        if "context" in options:
            self._client.tls_set_context(options["context"])
        subscribed = threading.Event()
        wanted = [(topic, 1) for topic in topics]

        def begin(client: Client, *_: Any) -> None:
            if wanted:
                client.subscribe(wanted)
            else:
                subscribed.set()

        self._client.on_connect = begin
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.connect("127.0.0.1", port, **(_keep_session() if session else {}))
        self._client.loop_start()
        assert subscribed.wait(30), f"no broker at port {port}"

    @property
    def is_connected(self) -> bool:
        return self._client.is_connected()

    def send_later(self, topic: str, payload: bytes, **properties: Any) -> None:
        """Publish when the broker is back."""
        assert not self._client.is_connected()
        self._client.publish(topic, payload, qos=1, properties=_make_properties(**properties))

    def send(
        self,
        topic: str,
        payload: bytes,
        *,
        response_topic: str | None = None,
        correlation: bytes | None = None,
        qos: int = 1,
        retain: bool = False,
        wait: bool = True,
    ) -> None:
        """Publish, and wait until the broker has it."""
        properties = _make_properties(response_topic, correlation)
        extra = {"properties": properties} if self._client.protocol == MQTTv5 else {}
        until(self._client.is_connected, "connection to the broker", every=0.02)
        sent = self._client.publish(topic, payload, qos=qos, retain=retain, **extra)
        if wait:
            sent.wait_for_publish(30)

    def receive(self) -> MQTTMessage:
        """Return the next message."""
        return self.received.get(timeout=120)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _keep_session() -> dict[str, Any]:
    """Return how to connect to a session that outlasts the connection."""
    properties = Properties(PacketTypes.CONNECT)
    properties.SessionExpiryInterval = 3600
    return {"clean_start": False, "properties": properties}


def _make_properties(
    response_topic: str | None = None, correlation: bytes | None = None
) -> Properties:
    properties = Properties(PacketTypes.PUBLISH)
    if response_topic is not None:
        properties.ResponseTopic = response_topic
    if correlation is not None:
        properties.CorrelationData = correlation
    return properties
