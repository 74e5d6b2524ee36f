"""A pod's ports on this machine: one websocket for each connection.

On a websocket, channel 0 is the data and channel 1 is an error text; the first message of each
repeats the port's number.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.kube.resources import path
from rigel_k8s.kube.websocket import Websocket, connect

DATA, ERROR = 0, 1
PROTOCOLS = ("v4.channel.k8s.io",)
BLOCK = 32 * 1024
LINGER = 10.0  # seconds that an answer may take after the local side has sent its last byte


@attrs.define
class Forward:
    """Ports that are forwarded.

    Attributes:
        ports: the pod's port to the local one.
        errors: failures of single connections, newest last.
        denied: the API server's answer that the right is missing: no connection will work.
    """

    ports: dict[int, int] = attrs.field(factory=dict)
    errors: list[str] = attrs.field(factory=list)
    denied: Forbidden | None = None


class Forwarding:
    """Ports of a cluster's pods."""

    client: Client

    @contextmanager
    def port_forward(
        self, namespace: str, pod: str, ports: Mapping[int, int], *, address: str = "127.0.0.1"
    ) -> Iterator[Forward]:
        """Forward ports of a pod to this machine while the context is open.

        Args:
            ports: the pod's port to the local one; 0 takes any that is free.
        """
        forward = Forward()
        listeners: list[socket.socket] = []
        try:
            for remote, local in ports.items():
                listener = listening(address, local)
                listeners.append(listener)
                forward.ports[remote] = listener.getsockname()[1]
                work = (self.client, namespace, pod, remote, listener, forward)
                threading.Thread(target=serve, args=work, daemon=True).start()
            yield forward
        finally:
            for listener in listeners:
                with suppress(OSError):
                    listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
                listener.close()


def listening(address: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        return socket.create_server((address, port), family=family)
    except OSError as error:
        raise UserError(
            f"cannot listen on port {port} of {address}: {error.strerror}",
            hint="choose another local port, or 0 for any that is free",
        ) from error


def serve(
    client: Client, namespace: str, pod: str, port: int, listener: socket.socket, forward: Forward
) -> None:
    """Accept connections until the listener is closed."""
    while True:
        try:
            local, _ = listener.accept()
        except OSError:
            return
        work = (client, namespace, pod, port, local, forward)
        threading.Thread(target=carry, args=work, daemon=True).start()


def carry(
    client: Client, namespace: str, pod: str, port: int, local: socket.socket, forward: Forward
) -> None:
    """Carry one connection to the pod and back."""
    what = f"forward port {port} of Pod {namespace}/{pod}"
    with local:
        try:
            resource = client.resource("v1", "Pod", what)
            url = path("v1", resource, namespace, pod, "portforward", query={"ports": port})
            session = connect(client, url, what, PROTOCOLS)
        except ClusterError as error:
            if isinstance(error, Forbidden) and error.ground == "right":
                forward.denied = error
            forward.errors.append(error.message)
            return
        over = threading.Event()
        with session:
            threading.Thread(target=carry_up, args=(local, session, over), daemon=True).start()
            carry_down(local, session, forward)
            over.set()
            with suppress(OSError):
                local.shutdown(socket.SHUT_RDWR)


def carry_up(local: socket.socket, session: Websocket, over: threading.Event) -> None:
    """Carry bytes to the pod until the local side closes.

    A websocket cannot be closed for one direction only, so an answer gets some time to arrive.
    """
    with suppress(OSError):
        while data := local.recv(BLOCK):
            session.send(DATA, data)
    over.wait(LINGER)
    session.abort()


def carry_down(local: socket.socket, session: Websocket, forward: Forward) -> None:
    """Carry bytes from the pod until it closes."""
    greeted = set()
    while (frame := session.receive(None)) is not None:
        channel, data = frame
        if channel not in greeted:
            greeted.add(channel)
            data = data[2:]
        if channel == ERROR and data:
            forward.errors.append(data.decode("utf-8", "replace"))
            return
        if data:
            try:
                local.sendall(data)
            except OSError:
                return
