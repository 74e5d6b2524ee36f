"""What a gate in front of roscore loses when its worker is killed again and again.

usage: python -m bench.gate_kills --root DIRECTORY [--kills 1000] [--seed 0]

The directory is as for `bench.gate`; its rosmaster runs in it. Callers set 40 parameters through
the gate as fast as they can, while its worker gets SIGKILL at random moments. Every 100 kills
rosmaster gets one as well and starts empty: then each parameter must have the value that was
answered last, or a later one. A call that fails or waits for longer than the gate's callers
would is counted as time in which the gate was deaf.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import tempfile
import threading
import time
import xmlrpc.client
from pathlib import Path
from typing import Any

import attrs

from bench.gate import GATE, MASTER, connect, start_gate, start_master, until_answers

CALLERS, KEYS = 4, 10
#: Seconds between two kills: a worker that has lived for a second is followed at once.
PAUSE = (1.05, 1.6)
#: Kills of the worker for one of rosmaster, and seconds that the gate may take to give back.
EACH, BACK = 100, 30.0


@attrs.define
class Caller:
    """Sets its parameters in turn, and notes what was answered, and how long a call took."""

    number: int
    answered: dict[str, int] = attrs.field(factory=dict)
    longest: float = 0.0
    sets: int = 0
    stop: bool = False

    def run(self) -> None:
        """Work until `stop` is set."""
        value, since = 0, time.monotonic()
        while not self.stop:
            value += 1
            key = f"/bench_{self.number}_{value % KEYS}"
            try:
                answer: Any = connect(GATE).setParam("/bench", key, value)
            except (OSError, xmlrpc.client.Error):
                continue  # it was killed with this call, which was not answered
            now = time.monotonic()
            self.longest, since = max(self.longest, now - since), now
            if answer[0] == 1:
                self.answered[key], self.sets = value, self.sets + 1


def find_lost(callers: list[Caller]) -> list[str]:
    """Return parameters that are older than what was answered, once the master has all again."""
    end = time.monotonic() + BACK
    while True:
        known = {key: value for one in callers for key, value in list(one.answered.items())}
        with contextlib.suppress(OSError):
            master = connect(MASTER)
            found: dict[str, Any] = {key: master.getParam("/bench", key) for key in known}
            lost = [k for k, (code, _, value) in found.items() if code != 1 or value < known[k]]
            if not lost or time.monotonic() >= end:
                return lost
        time.sleep(0.2)


def main() -> None:
    """Kill and compare; print what was lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    words = parser.parse_args()
    dice = random.Random(words.seed)
    with (
        tempfile.TemporaryDirectory() as directory,
        start_gate(directory) as gate,
        contextlib.ExitStack() as masters,
    ):
        master = masters.enter_context(start_master(words.root))
        until_answers(GATE)
        callers = [Caller(number) for number in range(CALLERS)]
        threads = [threading.Thread(target=one.run) for one in callers]
        for thread in threads:
            thread.start()
        lost: list[str] = []
        restarts = 0
        for number in range(1, words.kills + 1):
            time.sleep(dice.uniform(*PAUSE))
            children = Path(f"/proc/{gate}/task/{gate}/children").read_text().split()
            for child in children:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(child), signal.SIGKILL)
            if number % EACH == 0:
                longest = max(one.longest for one in callers)
                os.kill(master, signal.SIGKILL)
                masters.close()
                master = masters.enter_context(start_master(words.root))
                until_answers(MASTER)
                lost += find_lost(callers)
                restarts += 1
                sets = sum(one.sets for one in callers)
                print(
                    f"{number} kills: {sets} sets, {len(lost)} lost, deaf {longest:.1f} s at most"
                )
                for one in callers:
                    one.longest = 0.0
        for one in callers:
            one.stop = True
        for thread in threads:
            thread.join()
        print(f"lost: {', '.join(lost) or 'nothing'}, after {restarts} restarts of rosmaster")


if __name__ == "__main__":
    main()
