"""Runs docker and podman: their output line by line, and an end when the user asks for one."""

from __future__ import annotations

import os
import re
import selectors
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from rigel_k8s.errors import CommandFailed, Interrupted

__all__ = ["hint", "stream"]

LAST_LINES = 20
#: Seconds that a program has to end by itself after SIGTERM.
GRACE = 5.0

_POLL = 0.2
_WAYS_OUT = (
    (
        "http response to https client|tls handshake|certificate signed by unknown",
        "a registry without TLS, or with a certificate of its own, needs `insecure: true`",
    ),
    (
        "unauthorized|authentication required|access denied|access to the resource is denied",
        "the registry wants credentials: give them with a registry provider (docs/images.md)",
    ),
    (
        "exec format error",
        "the image is for another processor: install qemu-user-static, or leave that platform out",
    ),
)
_COLOUR = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")


def stream(
    words: Sequence[str],
    *,
    what: str,
    env: Mapping[str, str],
    cancel: threading.Event,
    on_line: Callable[[str], None] = lambda _: None,
) -> None:
    """Run a program to its end and hand on each line of its output.

    It leads a process group of its own, which is ended whole.

    Args:
        words: the program and its arguments.
        what: what it does, for the error: `podman build of app:1`.
        env: its whole environment.
        cancel: ends it when set.
        on_line: gets each line, without colours.

    Raises:
        CommandFailed: its exit code is not 0, or it could not be started; with its last lines.
        Interrupted: `cancel` was set.
    """
    last: deque[str] = deque(maxlen=LAST_LINES)
    process = _start(words, env, what)
    try:
        for line in _lines(process, cancel):
            last.append(line)
            on_line(line)
        if cancel.is_set():
            raise Interrupted(f"{what} was stopped")
        code = process.wait()
    finally:
        _end(process)
    if code != 0:
        raise CommandFailed(f"{what} failed (exit code {code})", hint=hint(last), details=[*last])


def hint(lines: Iterable[str]) -> str | None:
    """Return what helps against a failure that docker and podman report in these lines."""
    text = "\n".join(lines).lower()
    return next((way for pattern, way in _WAYS_OUT if re.search(pattern, text)), None)


def _start(words: Sequence[str], env: Mapping[str, str], what: str) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(
            words,
            env=dict(env),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        raise CommandFailed(f"{what} could not be started: {error}") from error


def _lines(process: subprocess.Popen[bytes], cancel: threading.Event) -> Iterator[str]:
    """Yield lines until the output ends, the program has ended, or cancel is set."""
    rest = b""
    for chunk in _chunks(process, cancel):
        *whole, rest = re.split(rb"[\r\n]+", rest + chunk)
        yield from filter(None, map(_clean, whole))
    if _clean(rest):
        yield _clean(rest)


def _chunks(process: subprocess.Popen[bytes], cancel: threading.Event) -> Iterator[bytes]:
    assert process.stdout is not None
    with selectors.DefaultSelector() as selector, process.stdout as output:
        selector.register(output, selectors.EVENT_READ)
        while not cancel.is_set():
            if selector.select(_POLL):
                chunk = os.read(output.fileno(), 65536)
                if not chunk:
                    return
                yield chunk
            elif process.poll() is not None:
                return  # something that it left behind holds the output open


def _clean(line: bytes) -> str:
    return _COLOUR.sub("", line.decode("utf-8", errors="replace")).rstrip()


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is not None:
        return
    os.killpg(process.pid, signal.SIGTERM)
    try:
        process.wait(GRACE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
