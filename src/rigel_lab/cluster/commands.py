"""Programs of this machine, run to their end; it knows no cluster."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rigel_k8s.errors import CommandFailed

__all__ = ["Report", "follow", "run", "search_path", "succeeds"]

#: Takes one line about what is being done.
Report = Callable[[str], None]

LAST_LINES = 15

#: Where ip, nft and iptables are; `su` leaves it out of $PATH.
ADMINISTRATORS_PATH = "/usr/local/sbin:/usr/sbin:/sbin"


def search_path() -> str:
    """Return $PATH with the directories of the administrator's programs."""
    return f"{os.environ.get('PATH', os.defpath)}:{ADMINISTRATORS_PATH}"


def run(
    command: Sequence[str],
    *,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    into: Path | None = None,
) -> str:
    """Run a program to its end and return what it printed on standard output.

    Args:
        command: the program and its arguments.
        cwd: where it runs.
        env: its environment; None is ours.
        into: a file that takes its standard output instead.

    Raises:
        CommandFailed: it is not there or exited other than 0; the details are its last lines.
    """
    try:
        with (into or Path("/dev/null")).open("wb") as file:
            done = subprocess.run(
                command,
                cwd=cwd,
                env={**(os.environ if env is None else env), "PATH": search_path()},
                check=False,
                stdin=subprocess.DEVNULL,
                stdout=file if into else subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
    except FileNotFoundError as error:
        raise CommandFailed(f"{command[0]} is not installed") from error
    output = (done.stdout or b"").decode(errors="replace")
    if done.returncode != 0:
        told = done.stderr.decode(errors="replace") or output
        raise failed(command, done.returncode, told.splitlines()[-LAST_LINES:])
    return output


def failed(command: Sequence[str], status: int, lines: Sequence[str]) -> CommandFailed:
    """Return the error of a program that exited other than 0."""
    words = " ".join([Path(command[0]).name, *command[1:3]])
    return CommandFailed(f"{words} exited {status}", details=lines)


def succeeds(command: Sequence[str]) -> bool:
    """Return whether a program exits 0; what it prints is of no interest."""
    environment = {**os.environ, "PATH": search_path()}
    done = subprocess.run(command, capture_output=True, check=False, env=environment)
    return done.returncode == 0


def follow(
    command: Sequence[str], each: Report, *, cwd: Path, env: Mapping[str, str] | None = None
) -> None:
    """Run a long program to its end and give each line of its standard error to `each`.

    Raises:
        CommandFailed: it exited other than 0; the details are its last lines.
    """
    last: list[str] = []
    with subprocess.Popen(
        command,
        cwd=cwd,
        env=env,
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            last = [*last, line.rstrip()][-LAST_LINES:]
            each(line.rstrip())
    if process.returncode != 0:
        raise failed(command, process.returncode, last)
