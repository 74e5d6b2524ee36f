"""Programs of this machine, the administrator's too; independent of clusters."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rigel_k8s.system import process

#: Called with one line about the present step.
Report = Callable[[str], None]
#: Seconds between two reports of how far one step is.
REPORT_EVERY = 1


class StepProgress(str):
    """How far the present step is: a report that the next one replaces where it can."""

    __slots__ = ()


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
    """Run a program to its end and return its standard output, as `system/process.py` does.

    Raises:
        CommandFailed: it is not installed, or failed; the details are its last lines.
    """
    return process.run(command, cwd=cwd, env=_environment(env), into=into)


def succeeds(command: Sequence[str]) -> bool:
    """Return whether a program ends with exit code 0; its output does not matter."""
    return process.succeeds(command, env=_environment(None))


def follow(
    command: Sequence[str], each: Report, *, cwd: Path, env: Mapping[str, str] | None = None
) -> None:
    """Run a long program to its end and give each line of its output to `each`.

    Raises:
        CommandFailed: it is not installed, or failed; the details are its last lines.
    """
    process.stream(command, cwd=cwd, env=_environment(env), on_line=each)


def _environment(given: Mapping[str, str] | None) -> dict[str, str]:
    return {**(os.environ if given is None else given), "PATH": search_path()}
