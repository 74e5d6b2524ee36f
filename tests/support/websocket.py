"""The server's side of a websocket with Kubernetes' channels, for answers of `HttpServer`."""

from __future__ import annotations

import hashlib
import struct
from base64 import b64encode

from tests.support.http_server import Exchange

GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455
BINARY, CLOSE = 2, 8


class Channels:
    """An open websocket; a message's first byte is its channel.

    Attributes:
        offered: the protocols that the client offers; the first one is taken, or `protocol`.
    """

    def __init__(self, exchange: Exchange, protocol: str = "") -> None:
        headers = exchange.headers
        self.exchange = exchange
        self.offered = [one.strip() for one in headers["Sec-WebSocket-Protocol"].split(",")]
        digest = hashlib.sha1((headers["Sec-WebSocket-Key"] + GUID).encode()).digest()
        exchange.send_response(101)
        exchange.send_header("Upgrade", "websocket")
        exchange.send_header("Connection", "Upgrade")
        exchange.send_header("Sec-WebSocket-Accept", b64encode(digest).decode())
        exchange.send_header("Sec-WebSocket-Protocol", protocol or self.offered[0])
        exchange.end_headers()
        exchange.hang_up()

    def send(self, channel: int, data: bytes) -> None:
        self._frame(BINARY, bytes([channel]) + data)

    def close(self) -> None:
        self._frame(CLOSE, b"")

    def receive(self) -> tuple[int, bytes] | None:
        """Return the next channel and bytes, None where the client has closed or gone."""
        head = self.exchange.rfile.read(2)
        if len(head) < 2 or head[0] & 15 == CLOSE:
            return None
        size = head[1] & 127
        if size > 125:
            form = "!H" if size == 126 else "!Q"
            [size] = struct.unpack(form, self.exchange.rfile.read(struct.calcsize(form)))
        mask = self.exchange.rfile.read(4)
        data = self.exchange.rfile.read(size)
        plain = bytes(byte ^ mask[place % 4] for place, byte in enumerate(data))
        return plain[0], plain[1:]

    def _frame(self, opcode: int, data: bytes) -> None:
        assert len(data) < 65536
        size = bytes([len(data)]) if len(data) < 126 else b"\x7e" + struct.pack("!H", len(data))
        self.exchange.wfile.write(bytes([128 | opcode]) + size + data)
