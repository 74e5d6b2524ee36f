"""Commands in a container, over the websocket protocol that kubectl speaks.

One websocket carries channels: 0 standard input, 1 output, 2 error, 3 the result, 4 the terminal's
size; 255 closes a channel (protocol v5).
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from io import BytesIO
from typing import Any, BinaryIO

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.resources import path
from rigel_k8s.kube.websocket import Websocket, connect

STDIN, STDOUT, STDERR, RESULT, RESIZE, CLOSE = 0, 1, 2, 3, 4, 255
PROTOCOLS = ("v5.channel.k8s.io", "v4.channel.k8s.io")
BLOCK = 32 * 1024


@attrs.frozen
class ExecResult:
    """The result of a command in a container."""

    code: int
    stdout: bytes
    stderr: bytes


class Execution:
    """Commands in the containers of a cluster's pods."""

    client: Client

    def run(
        self,
        namespace: str,
        pod: str,
        command: Sequence[str],
        *,
        container: str | None = None,
        stdin: bytes | None = None,
        timeout: float = 60.0,
    ) -> ExecResult:
        """Run a command in a container and return its output and exit code.

        Raises:
            ClusterError: it did not end within `timeout` seconds.
        """
        session = open_session(
            self.client, namespace, pod, command, container, stdin=stdin is not None, tty=False
        )
        deadline = time.monotonic() + timeout
        stdout, stderr = BytesIO(), BytesIO()
        with session:
            if stdin is not None:
                for start in range(0, len(stdin), BLOCK):
                    session.send(STDIN, stdin[start : start + BLOCK])
                end_of_input(session)
            result = receive(session, stdout, stderr, deadline)
        if result is None and time.monotonic() >= deadline:
            said = (stderr.getvalue() or stdout.getvalue()).decode("utf-8", "replace")
            raise ClusterError(
                f"{command[0]} in Pod {namespace}/{pod} did not end within {timeout:g} s",
                details=said.splitlines(),
            )
        code = exit_code(result, namespace, pod)
        return ExecResult(code, stdout.getvalue(), stderr.getvalue())

    def exec(
        self,
        namespace: str,
        pod: str,
        command: Sequence[str],
        *,
        stdout: BinaryIO,
        stderr: BinaryIO,
        stdin: BinaryIO | None = None,
        container: str | None = None,
        tty: bool = False,
    ) -> int:
        """Run a command in a container on the given streams and return its exit code.

        Args:
            tty: give it a terminal; `stdin` must be one too, and is in raw mode meanwhile.
        """
        session = open_session(
            self.client, namespace, pod, command, container, stdin=stdin is not None, tty=tty
        )
        terminal = Terminal(stdin, lambda size: send_size(session, size)) if tty and stdin else None
        pumping = threading.Thread(target=pump, args=(stdin, session), daemon=True)
        try:
            with session, terminal or nullcontext():
                if stdin is not None:
                    pumping.start()
                result = receive(session, stdout, stderr, None)
        finally:
            if pumping.is_alive():
                pumping.join()  # after this no one reads the caller's stream
        return exit_code(result, namespace, pod)


def open_session(
    client: Client,
    namespace: str,
    pod: str,
    command: Sequence[str],
    container: str | None,
    *,
    stdin: bool,
    tty: bool,
) -> Websocket:
    what = f"run {command[0]} in Pod {namespace}/{pod}"
    query: Mapping[str, Any] = {
        "command": list(command),
        "container": container,
        "stdin": stdin and "true",
        "stdout": "true",
        "stderr": not tty and "true",
        "tty": tty and "true",
    }
    resource = client.resource("v1", "Pod", what)
    url = path("v1", resource, namespace, pod, "exec", query=query)
    return connect(client, url, what, PROTOCOLS)


def receive(
    session: Websocket, stdout: BinaryIO, stderr: BinaryIO, deadline: float | None
) -> bytes | None:
    """Write a command's output until its session ends, and return what came of it, if anything."""
    streams = {STDOUT: stdout, STDERR: stderr}
    result = None
    while True:
        frame = session.receive(None if deadline is None else deadline - time.monotonic())
        if frame is None:
            return result
        channel, data = frame
        if channel in streams:
            streams[channel].write(data)
            streams[channel].flush()
        elif channel == RESULT:
            result = data


def end_of_input(session: Websocket) -> None:
    """Close the command's standard input, if the protocol can."""
    if session.protocol == PROTOCOLS[0]:
        session.send(CLOSE, bytes([STDIN]))


def pump(stdin: BinaryIO, session: Websocket) -> None:
    """Send a stream's bytes until its end, or until the session has ended."""
    number = stdin.fileno()
    while not session.closed:
        if not select.select([number], [], [], 0.2)[0]:
            continue
        data = os.read(number, BLOCK)
        if session.closed:
            return
        if not data:
            end_of_input(session)
            return
        session.send(STDIN, data)


def send_size(session: Websocket, size: os.terminal_size) -> None:
    """Send the terminal's size."""
    session.send(RESIZE, json.dumps({"Width": size.columns, "Height": size.lines}).encode())


def exit_code(result: bytes | None, namespace: str, pod: str) -> int:
    """Return the exit code from the result channel.

    Raises:
        ClusterError: the command could not be started, or the connection broke.
    """
    where = f"Pod {namespace}/{pod}"
    if result is None:
        raise ClusterError(
            f"the connection to {where} ended before the command did",
            hint="check with `rigel status` whether the pod was deleted or restarted",
        )
    status = json.loads(result)
    if status.get("status") == "Success":
        return 0
    for cause in (status.get("details") or {}).get("causes") or []:
        if cause.get("reason") == "ExitCode":
            return int(cause["message"])
    raise ClusterError(f"cannot run the command in {where}: {status.get('message')}")


class Terminal:
    """A terminal in raw mode: keys are passed to the command unread, its size is reported.

    Used as a context, which restores the terminal's own mode.
    """

    def __init__(self, stream: BinaryIO, resized: Callable[[os.terminal_size], None]):
        self.number = stream.fileno()
        self.resized = resized
        self.mode: list[Any] | None = None
        self.handler: Any = None

    def __enter__(self) -> Terminal:
        if os.isatty(self.number) and sys.platform != "win32":
            import termios
            import tty

            self.mode = termios.tcgetattr(self.number)
            tty.setraw(self.number)
            self.follow_size()
        return self

    def __exit__(self, *_: object) -> None:
        if self.mode is not None and sys.platform != "win32":
            import termios

            termios.tcsetattr(self.number, termios.TCSADRAIN, self.mode)
        if self.handler is not None:
            signal.signal(signal.SIGWINCH, self.handler)

    def follow_size(self) -> None:
        """Report the size now and whenever it changes."""
        self.report_size()
        if threading.current_thread() is threading.main_thread():
            self.handler = signal.signal(signal.SIGWINCH, lambda *_: self.report_size())

    def report_size(self) -> None:
        self.resized(os.get_terminal_size(self.number))
