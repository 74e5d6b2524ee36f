"""Runs other programs: to their end, or line by line with a way to stop them.

It is independent of their purpose; `what` names that in the errors.
"""

from __future__ import annotations

import math
import os
import re
import selectors
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import attrs

from rigel_k8s.errors import CommandFailed, Interrupted

#: How many lines of a failed program's output are in its error.
LAST_LINES = 20
#: Seconds that a program has to end after SIGTERM.
GRACE = 5.0
#: Seconds that it has to end by itself when what it has started was ended: podman cleans up then.
CLEAN_UP = 3.0

_POLL = 0.2
_COLOUR = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")


@attrs.frozen
class Finished:
    """How a program ended: its exit code, and what it printed to standard output and error."""

    code: int
    output: str
    errors: str

    @property
    def lines(self) -> list[str]:
        """All lines that it printed, those of standard error last."""
        return [*self.output.splitlines(), *self.errors.splitlines()]


def finish(
    words: Sequence[str],
    *,
    what: str = "",
    env: Mapping[str, str] | None = None,
    cwd: Path | None = None,
    into: Path | None = None,
    timeout: float | None = None,
) -> Finished:
    """Run a program to its end; no exit code is an error.

    Args:
        words: the program and its arguments.
        what: what it does, for errors; by default its first words.
        env: its whole environment; None is ours.
        cwd: where it runs.
        into: a file that takes its standard output.
        timeout: seconds until it is killed.

    Raises:
        CommandFailed: it could not be started, or did not end in time.
    """
    what = what or _first_words(words)
    try:
        with (into or Path(os.devnull)).open("wb") as file:
            done = subprocess.run(
                words,
                env=env,
                cwd=cwd,
                check=False,
                timeout=timeout,
                stdin=subprocess.DEVNULL,
                stdout=file if into else subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
    except subprocess.TimeoutExpired as error:
        raise CommandFailed(f"{what} did not end within {error.timeout:g} s") from error
    except OSError as error:
        raise _start_failure(words, what, error) from error
    return Finished(done.returncode, _decode(done.stdout or b""), _decode(done.stderr))


def run(
    words: Sequence[str],
    *,
    what: str = "",
    hint: str | None = None,
    env: Mapping[str, str] | None = None,
    cwd: Path | None = None,
    into: Path | None = None,
    timeout: float | None = None,
) -> str:
    """Run a program to its end and return its standard output; arguments as in `finish`.

    Args:
        hint: what to do when it fails.

    Raises:
        CommandFailed: it failed, could not be started, or did not end in time; with its last lines.
    """
    done = finish(words, what=what, env=env, cwd=cwd, into=into, timeout=timeout)
    if done.code != 0:
        raise _failure(what or _first_words(words), done.code, done.lines[-LAST_LINES:], hint)
    return done.output


def succeeds(words: Sequence[str], *, env: Mapping[str, str] | None = None) -> bool:
    """Return whether a program ends with exit code 0; its output does not matter."""
    return finish(words, env=env).code == 0


def stream(
    words: Sequence[str],
    *,
    what: str = "",
    hint: str | None = None,
    env: Mapping[str, str] | None = None,
    cwd: Path | None = None,
    cancel: threading.Event | None = None,
    on_line: Callable[[str], None] = lambda _: None,
    grace: float | None = None,
) -> None:
    """Run a program to its end and pass on each line of its output; arguments as in `run`.

    It leads a process group of its own, which is ended as a whole.

    Args:
        cancel: ends it when set.
        on_line: gets each line of both outputs that is not empty, without colours.
        grace: seconds that it has to end after SIGTERM; None: `GRACE`.

    Raises:
        CommandFailed: it failed or could not be started; with its last lines.
        Interrupted: `cancel` was set.
    """
    what = what or _first_words(words)
    cancel = cancel or threading.Event()
    last: deque[str] = deque(maxlen=LAST_LINES)
    process = _start(words, env, cwd, what)
    try:
        for line in _lines(process, cancel):
            last.append(line)
            on_line(line)
        if cancel.is_set():
            raise Interrupted(f"{what} was stopped")
        code = process.wait()
    finally:
        _end(process, GRACE if grace is None else grace)
    if code != 0:
        raise _failure(what, code, last, hint)


def _first_words(words: Sequence[str]) -> str:
    return " ".join([Path(words[0]).name, *words[1:3]])


def _failure(what: str, code: int, lines: Sequence[str], hint: str | None) -> CommandFailed:
    return CommandFailed(f"{what} failed (exit code {code})", hint=hint, details=lines)


def _start_failure(words: Sequence[str], what: str, error: OSError) -> CommandFailed:
    if isinstance(error, FileNotFoundError) and error.filename == words[0]:
        return CommandFailed(f"{words[0]} is not installed")
    return CommandFailed(f"{what} could not be started: {error}")


def _start(
    words: Sequence[str], env: Mapping[str, str] | None, cwd: Path | None, what: str
) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(
            words,
            env=env,
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        raise _start_failure(words, what, error) from error


def _lines(process: subprocess.Popen[bytes], cancel: threading.Event) -> Iterator[str]:
    """Yield lines until the output ends, the program has ended, or cancel was set."""
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
        end = math.inf
        while time.monotonic() < end:
            if cancel.is_set() and end == math.inf:
                end = time.monotonic() + (CLEAN_UP if _end_children(process.pid) else 0)
            if selector.select(_POLL):
                chunk = os.read(output.fileno(), 65536)
                if not chunk:
                    return
                yield chunk
            elif process.poll() is not None:
                return  # a process that it left behind holds the output open


def _decode(text: bytes) -> str:
    return text.decode("utf-8", errors="replace")


def _clean(line: bytes) -> str:
    return _COLOUR.sub("", _decode(line)).rstrip()


def _end_children(pid: int) -> bool:
    """End the processes that a program has started; return whether it has any, as far as known."""
    found = False
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # a thread or a child has ended meanwhile
            for child in file.read_text().split():
                found = True
                os.kill(int(child), signal.SIGTERM)
    return found


def _end(process: subprocess.Popen[bytes], grace: float) -> None:
    if process.poll() is not None:
        return
    os.killpg(process.pid, signal.SIGTERM)
    try:
        process.wait(grace)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
