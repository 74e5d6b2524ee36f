"""Runs docker and podman; an error has its cause, and a hint if one is known.

A failed build shows the step that failed, and keeps its complete output in a file.
"""

from __future__ import annotations

import os
import re
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress

from rigel_build.progress import failure
from rigel_k8s.errors import CommandFailed
from rigel_k8s.system import process
from rigel_k8s.system.cache import cache_dir

#: How many logs of failed builds are kept.
LOGS = 20

#: Seconds for a question to a program.
_PROBE_SECONDS = 60

_WAYS_OUT = (
    (
        "http response to https client|tls handshake|certificate signed by unknown",
        "a registry without TLS, or with a certificate of its own, needs `insecure: true`",
    ),
    (
        "unauthorized|authentication required|access denied|access to the resource is denied",
        "the registry needs credentials: set `username` and `password` in a registry provider",
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
    """Run a program to its end and pass on each line of its output.

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


def build(
    words: Sequence[str],
    *,
    what: str,
    env: Mapping[str, str],
    cancel: threading.Event,
    on_line: Callable[[str], None],
) -> None:
    """Run a build; arguments as in `stream`.

    Raises:
        CommandFailed: it failed, with the step that did and the file that has all of its output;
            or it could not be started.
        Interrupted: `cancel` was set.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8") as output:

        def note(line: str) -> None:
            output.write(f"{line}\n")
            on_line(line)

        try:
            stream(words, what=what, env=env, cancel=cancel, on_line=note)
        except CommandFailed as error:
            output.seek(0)
            text = output.read()
            if not text:
                raise
            details = [*(failure(text.split("\n")[:-1]) or error.details), _keep(what, text)]
            raise CommandFailed(error.message, hint=error.hint, details=details) from error


def _keep(what: str, text: str) -> str:
    """Store a failed build's output next to earlier ones; return where it is."""
    name = re.sub(r"[^A-Za-z0-9.]+", "-", what)[:100] + time.strftime("-%Y%m%d-%H%M%S-")
    try:
        directory = cache_dir() / "build-logs"
        directory.mkdir(parents=True, exist_ok=True)
        # Only its owner may read it: a build may print what it was given as an argument.
        descriptor, path = tempfile.mkstemp(".log", name, directory)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home directory
        return f"the complete log could not be written: {error}"
    with suppress(OSError):
        by_age = sorted(directory.glob("*.log"), key=lambda log: log.stat().st_mtime_ns)
        for old in by_age[:-LOGS]:
            old.unlink()
    return f"the complete log: {path}"


def hint(lines: Iterable[str]) -> str | None:
    """Return what helps against a failure that docker and podman report in these lines."""
    text = "\n".join(lines).lower()
    return next((way for pattern, way in _WAYS_OUT if re.search(pattern, text)), None)


def ask(words: Sequence[str], env: Mapping[str, str]) -> tuple[bool, str]:
    """Return whether a program succeeds, and its output, or why it did not start."""
    try:
        done = process.finish(words, env=env, timeout=_PROBE_SECONDS)
    except CommandFailed as error:
        return False, error.message
    return done.code == 0, "\n".join(done.lines)


def find_last(output: str) -> str:
    """Return the last line with text: it usually has the reason."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return lines[-1] if lines else "no reason given"
