"""A way to a server of this machine that can be cut, as a laptop's connection to a robot."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from .http_server import carry


class Relay:
    """Carries connections from a port of this machine to an address, while it is not cut."""

    def __init__(self, host: str, port: int) -> None:
        self.far = host, port
        self.open: set[socket.socket] = set()
        self.whole = threading.Event()
        self.whole.set()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self.listener.getsockname()[1]
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self) -> None:
        with suppress(OSError):  # it is closed
            while True:
                near, _ = self.listener.accept()
                threading.Thread(target=self.take, args=(near,), daemon=True).start()

    def take(self, near: socket.socket) -> None:
        """Carry one connection; while it is cut, it is closed at once."""
        with near, suppress(OSError):
            if not self.whole.is_set():
                return
            with socket.create_connection(self.far) as far:
                both = {near, far}
                self.open |= both
                threading.Thread(target=carry, args=(far, near), daemon=True).start()
                carry(near, far)
                self.open -= both

    def cut(self) -> None:
        """End all connections, and refuse others."""
        self.whole.clear()
        for one in list(self.open):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        self.whole.set()


@contextmanager
def relaying(host: str, port: int) -> Iterator[Relay]:
    made = Relay(host, port)
    try:
        yield made
    finally:
        made.listener.close()
        made.cut()
