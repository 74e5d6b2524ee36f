"""A websocket to the API server with Kubernetes' channels on it.

The websocket-client package implements the protocol; the connection is our transport's, so that
certificates, proxies and server names are the same as for every other request.
"""

from __future__ import annotations

import ssl
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rigel_k8s.kube.client import Client
from rigel_k8s.kube.transport import Answer

if TYPE_CHECKING:
    from websocket import WebSocket


class Websocket:
    """An open websocket; a message's first byte is its channel.

    Attributes:
        protocol: which of the offered protocols the server chose.
        closed: nothing can be sent any more.
    """

    def __init__(self, inner: WebSocket):
        self.inner = inner
        self.protocol: str = inner.getsubprotocol() or ""
        self.closed = False
        self.lock = threading.Lock()

    def __enter__(self) -> Websocket:
        return self

    def __exit__(self, *_: object) -> None:
        self.closed = True
        self.inner.shutdown()  # type: ignore[no-untyped-call]

    def send(self, channel: int, data: bytes) -> None:
        """Send bytes on a channel; after the end they are dropped."""
        import websocket

        with self.lock:
            try:
                if not self.closed:
                    self.inner.send_binary(bytes([channel]) + data)
            except (websocket.WebSocketException, OSError):
                self.closed = True

    def receive(self, timeout: float | None) -> tuple[int, bytes] | None:
        """Return the next channel and bytes; None at the end, or after `timeout` seconds."""
        import websocket

        if timeout is not None and timeout <= 0:
            return None
        self.inner.settimeout(timeout)
        try:
            data = self.inner.recv()
        except (websocket.WebSocketException, OSError):
            data = b""
        raw = data.encode() if isinstance(data, str) else bytes(data)
        if not raw:
            self.closed = True
            return None
        return raw[0], raw[1:]

    def abort(self) -> None:
        """End the connection from any thread; one that receives returns.

        Only the thread that opened the websocket closes its socket: a number that is free again may
        be the next connection's while the other thread still reads from it.
        """
        self.closed = True
        self.inner.abort()  # type: ignore[no-untyped-call]


def connect(client: Client, path: str, what: str, protocols: Sequence[str]) -> Websocket:
    """Open a websocket.

    Raises:
        ClusterError: the server refused, or did not answer.
    """
    import websocket

    transport = client.transport
    url = f"{transport.connections.url.scheme.replace('http', 'ws')}://{transport.connections.url.netloc}"
    connection = transport.open_socket(what)
    try:
        inner = websocket.create_connection(
            f"{url}{transport.connections.url.path}{path}",
            socket=connection,
            subprotocols=list(protocols),
            header=[f"{name}: {value}" for name, value in transport.connections.authorization()],
            suppress_origin=True,
            timeout=30,
        )
    except websocket.WebSocketBadStatusException as error:
        connection.close()
        answer = read_refusal(error)
    except (websocket.WebSocketException, OSError, ssl.SSLError, ValueError) as error:
        connection.close()
        raise transport.unreachable_error(what, error) from error
    else:
        return Websocket(inner)
    # Not while the first error is handled, whose text has the complete answer.
    client.raise_for(answer, what)
    raise client.garbled_error(what, path, answer.body, "it is not a websocket")


def read_refusal(error: Any) -> Answer:
    """Return the answer that a server gave instead of a websocket."""
    body = error.resp_body or b""
    return Answer(error.status_code, {}, body if isinstance(body, bytes) else body.encode())
