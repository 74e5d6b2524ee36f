"""Runs docker and podman; their failures come with a way out where one is known."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence

from rigel_k8s import process
from rigel_k8s.errors import CommandFailed

__all__ = ["hint", "stream"]

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


def stream(
    words: Sequence[str],
    *,
    what: str,
    env: Mapping[str, str],
    cancel: threading.Event,
    on_line: Callable[[str], None] = lambda _: None,
) -> None:
    """Run a program to its end and hand on each line of its output.

    Args:
        words: the program and its arguments.
        what: what it does, for the error: `podman push of app:1`.
        env: its whole environment.
        cancel: ends it when set.
        on_line: gets each line, without colours.

    Raises:
        CommandFailed: its exit code is not 0, or it could not be started; with its last lines.
        Interrupted: `cancel` was set.
    """
    try:
        process.stream(words, what=what, env=env, cancel=cancel, on_line=on_line)
    except CommandFailed as error:
        way = error.hint or hint(error.details)
        raise CommandFailed(error.message, hint=way, details=error.details) from error.__cause__


def hint(lines: Iterable[str]) -> str | None:
    """Return what helps against a failure that docker and podman report in these lines."""
    text = "\n".join(lines).lower()
    return next((way for pattern, way in _WAYS_OUT if re.search(pattern, text)), None)
