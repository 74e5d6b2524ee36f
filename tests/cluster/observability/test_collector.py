"""The collector's own program, with the configuration that is deployed, and a Loki of ours."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import pytest

from ...support.collector import LOG, line_of, run_collector, run_loki
from ...support.until import until

pytestmark = pytest.mark.cluster


@pytest.fixture
def log(tmp_path: Path) -> Iterator[TextIO]:
    """The log of a container, as the kubelet has it."""
    file = tmp_path / LOG
    file.parent.mkdir(parents=True)
    with file.open("a", buffering=1) as lines:
        yield lines


def write(log: TextIO, numbers: Iterable[int], every: float) -> None:
    """Write a line for each number, with some seconds between."""
    for number in numbers:
        log.write(line_of(number))
        time.sleep(every)


def test_a_killed_collector_loses_what_waits_to_be_joined(tmp_path: Path, log: TextIO) -> None:
    """At each kill at most the last line of a container, at 500 lines a second."""
    kills, size = 12, 700
    with run_loki() as loki:
        for first in range(0, kills * size, size):
            with run_collector(tmp_path, loki.server_port) as collector:
                write(log, range(first, first + size // 2), 0.002)
                until(partial(loki.has, first), "lines of this turn")
                killed = first + size - first // 31  # each time another moment
                write(log, range(first + size // 2, killed), 0.002)
                collector.kill()
                write(log, range(killed, first + size), 0)
        end = kills * size
        with run_collector(tmp_path, loki.server_port):
            write(log, range(end, end + 10), 0.1)
            until(partial(loki.has, end + 8), "the last lines")
    missing = [number for number in range(end) if not loki.has(number)]
    assert len(missing) <= kills, missing
    assert all(two - one > 1 for one, two in pairwise(missing)), missing


def test_power_cuts_lose_no_line_that_the_disk_has() -> None:
    """And the collector starts again. Four, as one does not always damage what is not synced."""
    words = [sys.executable, "-m", "bench.collectors", "--power", "--kills", "4"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=400)
    assert re.search(r"4 kills, [1-9]\d* lines, 0 lost", done.stdout), done.stdout + done.stderr
