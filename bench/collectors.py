"""What the logs' collector loses when it is killed, or when its machine loses power.

usage: python -m bench.collectors [--kills 100] [--rate 20] [--power] [--away] [--storage KEY...]

A container writes numbered lines without a pause, while the collector's program, with the
configuration that is deployed, sends them to a Loki of the bench, and gets SIGKILL at random
moments. Lines that the log has and Loki has not got at the end are lost.

With `--power`, the log and the collector have a disk of their own (a file with ext4), which loses
at each kill all that was not yet written to it, as in a power cut. Needs root.
With `--away`, Loki refuses all until the last kill. `--storage` switches options of the collector's
storage on, or off: `fsync`, `no-fsync`, `recreate`.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import random
import re
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import attrs

from tests.support.collector import LOG, Loki, line_of, run_collector, run_loki
from tests.support.until import until

#: Seconds that a collector runs: the disk of a machine writes by itself what is 5 to 30 s old.
KILLED, CUT = (0.5, 2.5), (2.0, 40.0)
#: Set where no other process sees the disk.
ALONE = "RIGEL_BENCH_ALONE"
#: EXT4_IOC_SHUTDOWN and its flag "do not write the journal first" (Linux, fs/ext4/ext4.h).
SHUTDOWN, NOT_EVEN_THE_JOURNAL = 0x8004587D, 2


@attrs.define
class Container:
    """Writes numbered lines into its log, in a thread, until it is stopped."""

    rate: float
    number: int = 0

    @contextlib.contextmanager
    def running(self, log: Path) -> Iterator[None]:
        """Write into a file."""
        log.parent.mkdir(parents=True, exist_ok=True)
        end = threading.Event()
        thread = threading.Thread(target=self._run, args=(log, end))
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join()

    def _run(self, log: Path, end: threading.Event) -> None:
        with contextlib.suppress(OSError), log.open("a", buffering=1) as lines:  # the power is cut
            while not end.wait(1 / self.rate):
                lines.write(line_of(self.number))
                self.number += 1


@contextlib.contextmanager
def disk(image: Path, directory: Path) -> Iterator[None]:
    """Mount a disk that loses at its end what was not yet written."""
    subprocess.run(["mount", "-o", "loop", image, directory], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", directory], check=True)


def cut_power(directory: Path) -> None:
    """Let the file system of a directory write nothing more, from now on."""
    place = os.open(directory, os.O_RDONLY)
    try:
        fcntl.ioctl(place, SHUTDOWN, struct.pack("I", NOT_EVEN_THE_JOURNAL))
    finally:
        os.close(place)


def read_numbers(logs: Iterable[Path]) -> set[int]:
    """Return the numbers of the lines that logs have."""
    return {int(one) for log in logs for one in re.findall(rb"count (\d+)\n", log.read_bytes())}


def kill_again_and_again(words: argparse.Namespace, directory: Path, loki: Loki) -> set[int]:
    """Kill collectors; return the numbers that the log has at the end."""
    dice, container, log = random.Random(words.seed), Container(words.rate), directory / LOG
    storage = {one.removeprefix("no-"): not one.startswith("no-") for one in words.storage}
    image = directory.with_suffix(".disk")
    if words.power:
        with image.open("wb") as file:
            file.truncate(512 * 2**20)
        subprocess.run(["mkfs.ext4", "-q", image], check=True)
    for turn in range(words.kills):
        with contextlib.ExitStack() as machine:
            if words.power:
                machine.enter_context(disk(image, directory))
                log = log.with_name(f"{turn}.log")  # the machine has started its container again
            with container.running(log), run_collector(directory, loki.server_port, storage) as it:
                time.sleep(dice.uniform(*(CUT if words.power else KILLED)))
                if words.power:
                    cut_power(directory)
                it.kill()
        if turn % 10 == 9:
            print(
                f"{turn + 1} kills, {container.number} lines written, {len(loki.numbers)} at Loki"
            )
    loki.away = False
    with contextlib.ExitStack() as machine:
        if words.power:
            machine.enter_context(disk(image, directory))
            log = log.with_name(f"{words.kills}.log")
        kept = read_numbers(log.parent.iterdir())
        with run_collector(directory, loki.server_port, storage) as it:
            with container.running(log):
                time.sleep(3)
            arrived = partial(loki.has, container.number - 2)
            until(arrived, "last lines", last_words=(directory / "output").read_text)
            it.terminate()
            it.wait()
    return kept


def main() -> None:
    """Kill and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--rate", type=float, default=20)
    parser.add_argument("--seed", type=int, default=0)
    for word in ("power", "away"):
        parser.add_argument(f"--{word}", action="store_true")
    parser.add_argument("--storage", nargs="*", default=[], metavar="KEY")
    words = parser.parse_args()
    if words.power and os.environ.get(ALONE) is None:
        # A disk that others see in a namespace of theirs is not the same as one that is gone.
        again = ["unshare", "--mount", sys.executable, "-m", "bench.collectors", *sys.argv[1:]]
        os.execvpe(again[0], again, {**os.environ, ALONE: "1"})
    with tempfile.TemporaryDirectory() as place, run_loki() as loki:
        directory = Path(place) / "machine"
        directory.mkdir()
        loki.away = words.away
        kept = kill_again_and_again(words, directory, loki)
        lost = sorted(kept - set(loki.numbers))
        again = sum(loki.numbers[one] - 1 for one in loki.numbers)
        print(f"{words.kills} kills, {len(kept)} lines, {len(lost)} lost, {again} twice")
        print(f"lost: {', '.join(map(str, lost)) or 'none'}")


if __name__ == "__main__":
    main()
