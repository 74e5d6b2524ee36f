"""Whole processes, timed from outside: wall seconds, processor seconds, peak memory."""

from __future__ import annotations

import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Sequence

import attrs


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


def run(*commands: Sequence[str]) -> Sample:
    """Run commands one after the other and add them up; a failing one ends the bench."""
    samples = [one(command) for command in commands]
    return Sample(
        wall=sum(s.wall for s in samples),
        cpu=sum(s.cpu for s in samples),
        memory=max(s.memory for s in samples),
    )


def one(command: Sequence[str]) -> Sample:
    """Run one command."""
    with tempfile.TemporaryFile() as output:
        start = time.monotonic()
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
        )
        _, status, usage = os.wait4(child.pid, 0)
        wall = time.monotonic() - start
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode != 0:
            output.seek(0)
            text = output.read().decode(errors="replace")
            raise SystemExit(f"{' '.join(command)} exited {child.returncode}\n{text}")
    return Sample(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)
