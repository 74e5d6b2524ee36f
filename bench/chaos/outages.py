"""Outages: the API server is unreachable for a minute, from each request of a command on.

usage: python -m bench.chaos.outages [--seconds 60] [--every 3] [--workers 12]
       prints a table: command, phase, outages, exit codes, seconds
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import attrs

from bench.chaos.calling import Caller
from bench.chaos.control_plane import Server, control_plane
from bench.chaos.faults import Outage, Weather
from bench.chaos.kubelet import kubelet
from bench.chaos.proxy import fault_proxy
from bench.chaos.stories import UNHURRIED, Content, Story, rigelfile

IMAGE = f"reg.invalid/ros@sha256:{'a' * 64}"
OLD, NEW = Content(1, ("camera", "talker"), IMAGE), Content(2, ("camera", "driver"), IMAGE)
DEPLOY = ["run", "job", "deploy", "--timeout", UNHURRIED]
DOWN = ["down", "-y"]
#: Command -> the release before, its arguments, the release after, how many requests it makes.
COMMANDS = {
    "first deploy": (None, DEPLOY, OLD, 30),
    "update that renames a node": (OLD, DEPLOY, NEW, 36),
    "rollback": (NEW, ["rollback", "1", "--timeout", UNHURRIED], OLD, 36),
    "down": (OLD, DOWN, None, 40),
}
MODES: tuple[Outage, ...] = ("reset", "503 page", "503")


@attrs.frozen
class Case:
    """One outage: its command, its first request, and its kind."""

    number: int
    command: str
    first: int
    mode: Outage


@attrs.frozen
class Result:
    """The result of a case."""

    case: Case
    met: str
    code: int
    seconds: float
    wrong: str
    output: str


def main() -> None:
    """Play all cases, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.chaos.outages", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--every", type=int, default=3, help="go away at each n-th request")
    parser.add_argument("--workers", type=int, default=12)
    words = parser.parse_args()
    cases = list(list_cases(words.every))
    with tempfile.TemporaryDirectory(prefix="rigel-outages-") as temporary:
        directory = Path(temporary)
        callers = [Caller() for _ in range(words.workers)]  # before there are threads
        with (
            control_plane(directory) as server,
            kubelet(server),
            ThreadPoolExecutor(words.workers) as pool,
        ):

            def play(case: Case) -> Result:
                caller = callers.pop()
                try:
                    return play_case(case, caller, server, directory, words.seconds)
                finally:
                    callers.append(caller)

            print_table([result for result in pool.map(play, cases) if result.met])


def list_cases(every: int) -> Iterator[Case]:
    """Yield which outages are played."""
    number = 0
    for command, (*_, requests) in COMMANDS.items():
        for first in range(0, requests, every):
            yield Case(number, command, first, MODES[number % len(MODES)])
            number += 1


def play_case(
    case: Case, caller: Caller, server: Server, directory: Path, seconds: float
) -> Result:
    """Prepare the release, run the command during the outage, and compare."""
    before, words, after, _ = COMMANDS[case.command]
    place = directory / f"case-{case.number}"
    place.mkdir()
    with fault_proxy(server.url) as proxy, server.connect() as cluster:
        story = Story(case.number, proxy, caller, cluster, server.token, place)
        story.configure()
        for content in [OLD, NEW] if before == NEW else [before] if before else []:
            story.write("Rigelfile", rigelfile(story.namespace, content))
            story.call(DEPLOY, faults=False)
        story.write("Rigelfile", rigelfile(story.namespace, after or OLD))
        proxy.begin(Weather("", 0.0, (), case.mode, case.first, seconds))
        started = time.monotonic()
        code, output = story.call(words, faults=False, hang=seconds + 240)
        spent = time.monotonic() - started
        met = proxy.met
        proxy.begin(None)
        wrong = story.find_wrong(after, code, output, faults=True)
        return Result(case, met, code, spent, wrong, output)


def print_table(results: list[Result]) -> None:
    """Print what happened by command and phase, and what went wrong."""
    groups: dict[tuple[str, str], list[Result]] = defaultdict(list)
    for result in results:
        phase = "first request" if not result.case.first else phase_of(result.met)
        groups[result.case.command, phase].append(result)
    print("\n| command | phase | outages | ended well | ended with an error | wrong | seconds |")
    print("|---|---|---|---|---|---|---|")
    for (command, phase), found in groups.items():
        well = sum(result.code == 0 for result in found)
        wrong = sum(bool(result.wrong) for result in found)
        times = sorted(round(result.seconds) for result in found)
        row = (
            command,
            phase,
            len(found),
            well,
            len(found) - well,
            wrong,
            f"{times[0]}-{times[-1]}",
        )
        print("|", " | ".join(map(str, row)), "|", flush=True)
    for result in results:
        if result.wrong or (result.code and result.case.first):
            print(result.case, result.met, result.wrong)
            print("\n".join(f"    {line}" for line in result.output.splitlines()[-30:]))


def phase_of(request: str) -> str:
    """Return the phase of a command that a request belongs to."""
    method, _, path = request.partition(" ")
    if "/leases" in path:
        return "Lease"
    if "/secrets" in path and method != "GET":
        return "record"
    if "dryRun" in path:
        return "dry run"
    if "watch=" in path:
        return "wait"
    return {"PATCH": "apply", "POST": "apply", "DELETE": "prune"}.get(method, "survey")


if __name__ == "__main__":
    main()
