"""Plays stories: releases whose commands meet faults; prints errors and figures.

usage: python -m bench.chaos --seed N [--runs M] [--workers W]
       the stories of the seeds N to N+M-1, five commands with faults each; one that goes wrong
       prints its seed, and `--seed SEED --runs 1` plays it again
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import attrs

from bench.chaos.calling import Caller
from bench.chaos.control_plane import Server, control_plane
from bench.chaos.kubelet import kubelet
from bench.chaos.proxy import fault_proxy
from bench.chaos.stories import Outcome, play

EVERY = 20  # stories between two lines of figures


def main() -> None:
    """Play and print; exit code 1 if anything went wrong."""
    parser = argparse.ArgumentParser(prog="python -m bench.chaos", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=1, help="how many stories")
    parser.add_argument("--workers", type=int, default=4, help="stories at once")
    parser.add_argument("--minutes", type=float, help="begin no story after that")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="rigel-chaos-") as temporary:
        directory = Path(temporary)
        # Before there are threads: what forks later must have none.
        callers = [Caller() for _ in range(min(words.workers, words.runs))]
        # The control plane is a child of this process: it must not outlive it.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        with control_plane(directory) as server:
            seeds = range(words.seed, words.seed + words.runs)
            end = time.monotonic() + 60 * (words.minutes or 1e9)
            sys.exit(play_all(seeds, callers, server, directory, end))


def play_all(
    seeds: range, callers: list[Caller], server: Server, directory: Path, end: float
) -> int:
    """Play all stories, some at once; return the exit code.

    Args:
        end: when the last story may begin, on the monotonic clock.
    """
    started, wrong = time.monotonic(), 0
    read, write = os.pipe()
    workers = []
    for i, caller in enumerate(callers):
        workers.append(os.fork())
        if not workers[-1]:
            try:
                os.close(read)
                mine = (seed for seed in seeds[i :: len(callers)] if time.monotonic() < end)
                work(mine, caller, server, directory, write)
            finally:
                os._exit(0)
    os.close(write)
    codes, faults, stories = Counter[str](), Counter[str](), 0
    with ending(workers), kubelet(server), os.fdopen(read) as lines:
        for line in lines:
            item = json.loads(line)
            if "faults" in item:
                stories += 1
                faults.update(item["faults"])
            else:
                outcome = Outcome(**item)
                faulty = outcome.command.endswith("with faults")
                codes[f"exit code {outcome.code}" if faulty else "repeated without faults"] += 1
                wrong += bool(outcome.wrong)
                report(outcome)
            if "faults" in item and stories % EVERY == 0:
                print_figures(stories, started, wrong, codes)
    print_figures(stories, started, wrong, codes)
    print("faults:", ", ".join(f"{n} {word}" for word, n in faults.most_common()))
    return 1 if wrong or not stories else 0


@contextmanager
def ending(workers: Iterable[int]) -> Iterator[None]:
    """End the processes that play when the context ends, in the middle of a story if need be."""
    try:
        yield
    finally:
        for worker in workers:
            os.kill(worker, signal.SIGTERM)
            os.waitpid(worker, 0)


def print_figures(stories: int, started: float, wrong: int, codes: Counter[str]) -> None:
    """Print the progress."""
    figures = ", ".join(f"{n} {word}" for word, n in sorted(codes.items()))
    spent = time.monotonic() - started
    print(f"{stories} stories in {spent:.0f} s, {wrong} wrong: {figures}", flush=True)


def report(outcome: Outcome) -> None:
    """Print what went wrong."""
    if outcome.wrong:
        place = f"seed {outcome.seed}, step {outcome.step}, `rigel {outcome.command}`"
        print(f"WRONG: {place}: {outcome.wrong}; exit code {outcome.code}", flush=True)
        print("\n".join(f"    {line}" for line in outcome.output.splitlines()[-60:]), flush=True)


def work(
    seeds: Iterable[int], caller: Caller, server: Server, directory: Path, output: int
) -> None:
    """Play stories one after the other, and write their outcomes as lines of JSON."""
    with server.connect() as cluster, fault_proxy(server.url) as proxy:
        for seed in seeds:
            before = proxy.injected.copy()
            try:
                for outcome in play(seed, proxy, caller, cluster, server.token, directory):
                    send(output, attrs.asdict(outcome))
            except Exception:  # a failure of the bench counts too
                text = traceback.format_exc()
                send(output, attrs.asdict(Outcome(seed, -1, "bench", 70, "the bench failed", text)))
            send(output, {"faults": dict(proxy.injected - before)})


def send(output: int, value: object) -> None:
    """Write a complete line of JSON."""
    data = json.dumps(value).encode() + b"\n"
    while data:
        data = data[os.write(output, data) :]


if __name__ == "__main__":
    main()
