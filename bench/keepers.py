"""What the keeper beside an idle ROS 2 node costs, and how soon it replaces one that was killed.

usage: python -m bench.keepers [--idle 60] [--kills 20]

A middleware in memory stands for ROS 2's; nodes, keepers and their connections are real. A keeper
has worked for some minutes when it is measured, as it looks for other pods more often before. What
is killed is the keeper that works and its node, by SIGKILL; the other one waits and is fit.
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import attrs

from rigel_inpod.rmw_notes import WAIT, WORK
from tests.support.layer import Built, Node, build, name, start_keeper
from tests.support.until import until

#: Seconds until a keeper looks for other pods as rarely as it will.
SETTLED = 305


@attrs.frozen
class Pod:
    """A node with the layer, and its keeper."""

    node: Node
    keeper: subprocess.Popen[str]

    def says(self, line: str) -> bool:
        """Whether its keeper has reported this."""
        progress = self.node.directory / "progress"
        return progress.exists() and line in progress.read_text("utf-8")

    def kill(self) -> None:
        """End both at once."""
        for process in (self.node.process, self.keeper):
            process.kill()
        for process in (self.node.process, self.keeper):
            process.wait()


def start(built: Built, directory: Path, port: int) -> Pod:
    """Start a pod of the one workload."""
    directory.mkdir()
    env = {**os.environ, "RIGEL_RMW": str(directory), "RIGEL_RMW_MODE": "wait", **built.options}
    process = subprocess.Popen(
        [str(word) for word in built.main],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**env, "LD_PRELOAD": str(built.preload)},
    )
    node = name(Node(process, directory))
    node.do("create p /out 0")
    node.do("publish /out 1")  # it acts, so it is fit
    return Pod(node, start_keeper(node, directory.name, port)[1])


def rest(pod: Pod, seconds: float) -> tuple[float, float]:
    """Return the part of a core, and the MB, that the keeper of an idle node needs."""
    pod.node.send("wait 100000000")
    time.sleep(SETTLED)
    before = read_ticks(pod.keeper.pid)
    time.sleep(seconds)
    used = (read_ticks(pod.keeper.pid) - before) / os.sysconf("SC_CLK_TCK") / seconds
    words = Path(f"/proc/{pod.keeper.pid}/smaps_rollup").read_text().split()
    return used, int(words[words.index("Pss:") + 1]) * 1024 / 1e6


def read_ticks(process: int) -> int:
    """Return the processor time of a process, in the kernel's ticks."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13]))


def replace(old: Pod, new: Pod) -> float:
    """Kill a pod that works; return the seconds until the other one does."""
    old.kill()
    began = time.monotonic()
    while new.node.notes.mode != WORK:
        time.sleep(0.001)
    return time.monotonic() - began


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--idle", type=float, default=60)
    parser.add_argument("--kills", type=int, default=20)
    asked = parser.parse_args()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = int(free.getsockname()[1])
    with tempfile.TemporaryDirectory() as room:
        built = build(Path(room))
        pod = start(built, Path(room, "idle"), port)
        part, size = rest(pod, asked.idle)
        pod.kill()
        sys.stdout.write(f"The keeper of an idle node: {part:.2%} of a core, {size:.1f} MB\n")
        times = []
        works = start(built, Path(room, "pod-0"), port)
        until(lambda: works.node.notes.mode == WORK, "the first one works", 60)
        for number in range(1, asked.kills + 1):
            waits = start(built, Path(room, f"pod-{number}"), port)
            until(lambda w=waits: w.node.notes.mode == WORK, "it takes over", 60)
            until(lambda w=works: w.node.notes.mode == WAIT and w.says("waits"), "it waits", 60)
            time.sleep(1)
            times.append(replace(waits, works))
        works.kill()
    middle, longest = statistics.median(times), max(times)
    sys.stdout.write(
        f"One that was killed is replaced after {middle:.3f} s (median of {len(times)}),"
        f" {longest:.3f} s at most\n"
    )


if __name__ == "__main__":
    main()
