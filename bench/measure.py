"""Whole processes, timed from outside: wall seconds, processor seconds, peak memory."""

from __future__ import annotations

import os
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence

import attrs


class CommandFailed(SystemExit):
    """A command that failed or was too slow; unless it is caught, it ends the bench."""


class TooSlow(CommandFailed):
    """A command that was ended because it took longer than it may."""


@attrs.frozen
class Sample:
    """One finished run: wall and processor time in seconds, peak memory in MiB."""

    wall: float
    cpu: float
    memory: float


@attrs.define
class Figure:
    """The runs of one command."""

    samples: list[Sample] = attrs.field(factory=list)

    def median(self, field: str) -> float:
        """Return the median of `wall`, `cpu` or `memory`."""
        return statistics.median(getattr(sample, field) for sample in self.samples)


def run(*commands: Sequence[str], limit: float = 3600) -> Sample:
    """Run commands one after the other and add them up.

    Args:
        limit: seconds that all commands together may take.

    Raises:
        CommandFailed: a command failed; those after it did not run.
        TooSlow: they took longer.
    """
    end = time.monotonic() + limit
    samples = [one(command, end - time.monotonic()) for command in commands]
    return Sample(
        wall=sum(s.wall for s in samples),
        cpu=sum(s.cpu for s in samples),
        memory=max(s.memory for s in samples),
    )


def one(command: Sequence[str], limit: float) -> Sample:
    """Run one command."""
    with tempfile.TemporaryFile() as output:
        start = time.monotonic()
        child = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        timer = threading.Timer(max(limit, 0), child.kill)
        timer.start()
        try:
            _, status, usage = os.wait4(child.pid, 0)
        except BaseException:  # a signal: what we started ends with us
            child.kill()
            child.wait()
            raise
        finally:
            timer.cancel()
        wall = time.monotonic() - start
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode != 0 and wall >= limit:
            raise TooSlow(f"{' '.join(command)} did not end in time")
        if child.returncode != 0:
            output.seek(0)
            text = output.read().decode(errors="replace")
            raise CommandFailed(f"{' '.join(command)} exited {child.returncode}\n{text}")
    return Sample(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)
