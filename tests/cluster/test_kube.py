"""The client against a real kubelet: terminals and ports."""

from __future__ import annotations

import io
import os
import pty
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import ObjectRef
from tests.support.until import until

from .conftest import wait_for_account

pytestmark = pytest.mark.cluster


@pytest.fixture(scope="module")
def pod(cluster: Any, registry: str) -> Iterator[ObjectRef]:
    """A running pod with a shell."""
    namespace = ObjectRef("v1", "Namespace", "", f"kube-test-{os.getpid()}")
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": namespace.name}})
    manifest = shell_pod(namespace.name, registry)
    wait_for_account(cluster, namespace.name)
    cluster.apply(manifest)
    made = ObjectRef("v1", "Pod", namespace.name, "shell")
    until(lambda: cluster.get(made)["status"].get("phase") == "Running", "a running pod", 240)
    yield made
    cluster.delete(namespace)


def shell_pod(namespace: str, registry: str) -> dict[str, Any]:
    loop = "trap 'exit 0' TERM; while true; do sleep 0.2; date; done"
    container = {
        "name": "sh",
        "image": f"{registry}/rigel-k8s/busybox:1",
        "command": ["sh", "-c", loop],
    }
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {"name": "shell", "namespace": namespace},
        "spec": {"terminationGracePeriodSeconds": 1, "containers": [container]},
    }


def test_a_terminal_is_a_terminal(cluster: Any, pod: ObjectRef) -> None:
    """`exec -it`: raw keys, the window's size, and the terminal's own mode afterwards."""
    import fcntl
    import struct
    import termios

    outer, inner = pty.openpty()
    fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", 33, 77, 0, 0))
    before = termios.tcgetattr(inner)
    output = io.BytesIO()
    # The size comes beside the keys, and perhaps after them.
    line = b"until stty size | grep 33.77; do sleep 0.2; done; tty; exit 5\r"

    def press_keys() -> None:
        until(lambda: termios.tcgetattr(inner) != before, "raw mode, which forgets earlier keys")
        os.write(outer, line)

    with open(inner, "rb", buffering=0) as stdin:  # noqa: PTH123  a descriptor, no path
        keys = threading.Thread(target=press_keys)
        keys.start()
        code = cluster.exec(
            pod.namespace, pod.name, ["sh"], stdin=stdin, stdout=output, stderr=output, tty=True
        )
        keys.join()
        assert termios.tcgetattr(inner) == before
    os.close(outer)
    assert code == 5
    assert b"/dev/pts/" in output.getvalue()
    assert b"33 77" in output.getvalue()


def test_a_port_is_forwarded_once_for_each_connection(cluster: Any, pod: ObjectRef) -> None:
    """Two connections one after the other; one to a closed port fails and the next one works."""
    server = "while true; do echo pong | nc -l -p 7000; done"
    serving = threading.Thread(
        target=lambda: run_until_killed(cluster, pod, ["sh", "-c", server]), daemon=True
    )
    serving.start()
    with cluster.port_forward(pod.namespace, pod.name, {7000: 0, 7001: 0}) as forward:
        until(lambda: answer(forward.ports[7000]) == b"pong\n", "pong", 120)
        assert answer(forward.ports[7001]) == b""
        assert any("7001" in error for error in forward.errors)
        until(lambda: answer(forward.ports[7000]) == b"pong\n", "pong", 120)
        port = forward.ports[7000]
        with pytest.raises(UserError, match="cannot listen"):
            cluster.port_forward(pod.namespace, pod.name, {1: port}).__enter__()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port), timeout=5)


def run_until_killed(cluster: Any, pod: ObjectRef, command: list[str]) -> None:
    with suppress(ClusterError):
        cluster.run(pod.namespace, pod.name, command, timeout=300)


def answer(port: int) -> bytes:
    """Return what a local port says."""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
        try:
            return connection.recv(100)
        except ConnectionResetError:
            return b""
