"""The client against a real API server: logs, commands, ports, tokens."""

from __future__ import annotations

import io
import json
import os
import pty
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError, NotFoundError, UserError
from rigel_k8s.kube import ObjectRef
from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.kubeconfig import load
from tests.support.until import until

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
    loop = "echo one; echo two; trap 'exit 0' TERM; while true; do sleep 0.2; date; done"
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


def wait_for_account(cluster: Any, namespace: str) -> None:
    """A pod is refused while its namespace has no service account yet."""
    account = ObjectRef("v1", "ServiceAccount", namespace, "default")
    until(lambda: cluster.get(account), "a service account", 120)


def test_logs_are_lines_and_a_follow_can_be_ended(cluster: Any, pod: ObjectRef) -> None:
    """The first lines, the last lines, and a follow that `cancel` ends."""

    def read() -> list[str]:
        lines = list(cluster.logs(pod.namespace, pod.name))
        return lines if len(lines) > 1 else []

    lines = until(read, "two lines of a container that may have just started")
    assert lines[:2] == ["one", "two"]
    assert len(list(cluster.logs(pod.namespace, pod.name, tail=2))) == 2
    cancel, got = threading.Event(), []
    for line in cluster.logs(pod.namespace, pod.name, follow=True, tail=0, cancel=cancel):
        got.append(line)
        if len(got) == 2:
            cancel.set()
    assert len(got) >= 2
    with pytest.raises(NotFoundError):
        list(cluster.logs(pod.namespace, "nobody"))


def test_a_command_runs_with_input_output_and_exit_code(cluster: Any, pod: ObjectRef) -> None:
    """Large input, both outputs, the exit code; a deadline; a command that is not there."""
    script = "cat | wc -c; echo wrong >&2; exit 3"
    done = cluster.run(pod.namespace, pod.name, ["sh", "-c", script], stdin=b"x" * 200_000)
    assert (done.code, done.stdout.strip(), done.stderr) == (3, b"200000", b"wrong\n")
    with pytest.raises(ClusterError, match="did not end within 1 s"):
        cluster.run(pod.namespace, pod.name, ["sh", "-c", "sleep 5"], timeout=1)
    with pytest.raises(ClusterError, match="no-such-command"):
        cluster.run(pod.namespace, pod.name, ["no-such-command"])


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


def test_a_token_is_who_we_are(cluster: Any, context: str, namespace: str) -> None:
    """A service account's token connects, and what it may not do is a hint to `auth can-i`."""
    wait_for_account(cluster, namespace)
    ref = ObjectRef("v1", "ServiceAccount", namespace, "default")
    url = cluster.client.path_of(ref, "test", subresource="token")
    body = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenRequest", "spec": {}}
    token = cluster.client.call("POST", url, "test", read_mapping, body=body)["status"]["token"]

    def credentials() -> Any:
        from rigel_k8s.kube.target import Credentials

        return Credentials(headers=lambda *, fresh: [("Authorization", f"Bearer {token}")])

    with Cluster(attrs.evolve(load(context=context), credentials=credentials)) as other:
        assert other.server_version().startswith("v1.")
        with pytest.raises(ClusterError, match=f"serviceaccount:{namespace}:default") as caught:
            other.get(ObjectRef("v1", "Secret", namespace, "x"))
        assert "auth can-i" in (caught.value.hint or "")

    def nobody() -> Any:
        from rigel_k8s.kube.target import Credentials

        return Credentials(headers=lambda *, fresh: [("Authorization", "Bearer wrong")])

    with Cluster(attrs.evolve(load(context=context), credentials=nobody)) as other:
        with pytest.raises(ClusterError) as caught:
            other.nodes()
        assert "log in again" in (caught.value.hint or "")


@pytest.mark.parametrize("version", ["", "&resourceVersion=0"])
def test_a_watch_may_begin_at_no_version(cluster: Any, version: str) -> None:
    """Scripts and other tools watch so; a storage that cannot stream lists made errors of it."""
    path = f"/api/v1/namespaces?watch=true&timeoutSeconds=1{version}"

    def watch() -> bool:
        answer = cluster.client.transport.request("GET", path, "watch namespaces")
        kinds = {json.loads(line)["type"] for line in answer.body.splitlines()}
        assert "ERROR" not in kinds
        return "ADDED" in kinds

    until(watch, "namespaces within the second of a watch")
