"""Check and render mutated Rigelfiles in a worker process; print what goes wrong.

usage: python -m bench.fuzz --seed N --runs M [--from K] [--to DIRECTORY]

A finding is a traceback, an exit code other than 0 and 2, more than a second of the processor, more
than 200 MB, or a worker that died. Each is printed with the seed that makes it again
(`--seed N --from K --runs 1`), and its file, made smaller, is left in the directory.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache, partial
from importlib import metadata
from pathlib import Path
from typing import Any

from bench.fuzz.mutation import mutate, seeds

SECONDS, KILOBYTES, DEADLINE = 1.0, 200 * 1024, 120.0
#: Files of one worker: click keeps every stream that it has written to, 2 KB for each file.
RENEWED = 20_000
COMMANDS = ("check", "render")


def main() -> None:
    """Run, and print a line for each finding and a summary."""
    words = arguments()
    words.to.mkdir(parents=True, exist_ok=True)
    texts, number, found, began = seeds(), words.begin, 0, time.monotonic()
    end = words.begin + words.runs
    while number < end:
        number, message = work(words.seed, number, end, texts)
        if message:
            found += 1
            content = mutate(texts, f"{words.seed}/{number - 1}")
            reason = message.rpartition("\nThis is a bug")[0].rpartition("\n")[2] or message
            if "exit code" in message:
                content = minimize(content, partial(fails_with, reason))
            (words.to / f"{words.seed}-{number - 1}.Rigelfile").write_bytes(content)
            print(f"--seed {words.seed} --from {number - 1} --runs 1: {message}", flush=True)
    seconds = time.monotonic() - began
    commands = len(COMMANDS) * words.runs
    print(f"{words.runs} files, {commands} commands, {found} findings, {seconds:.0f} s")
    sys.exit(bool(found))


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.fuzz", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--from", dest="begin", type=int, default=0, help="the first run's number")
    parser.add_argument("--to", type=Path, default=Path(".fuzz"), help="where findings are left")
    return parser.parse_args()


def work(seed: int, begin: int, end: int, texts: list[str]) -> tuple[int, str | None]:
    """Examine files in a worker until one is a finding; return the next number and the finding."""
    end = min(end, begin + RENEWED)
    here, there = multiprocessing.Pipe()
    worker = multiprocessing.get_context("fork").Process(
        target=look_at_all, args=(there, seed, begin, end, texts)
    )
    worker.start()
    there.close()
    number = begin
    try:
        while here.poll(DEADLINE):
            number, message = here.recv()
            if number % 1000 == 0:
                print(f"{number} files", file=sys.stderr, flush=True)
            if message or number == end:
                return number, message
        return number + 1, f"no end within {DEADLINE:g} s"
    except EOFError:
        worker.join()
        return number + 1, f"the worker died with {worker.exitcode}"
    finally:
        worker.kill()
        worker.join()


def look_at_all(there: Any, seed: int, begin: int, end: int, texts: list[str]) -> None:
    """Examine one file after the other, and send the progress and each finding."""
    os.environ["XDG_STATE_HOME"] = "/nonexistent"
    os.environ["KUBECONFIG"] = "/nonexistent"
    # No packages are installed meanwhile, and the search for them takes half of the time.
    metadata.entry_points = cache(metadata.entry_points)
    with tempfile.TemporaryDirectory() as place:
        for number in range(begin, end):
            message = look(Path(place), mutate(texts, f"{seed}/{number}"))
            there.send((number + 1, message))
            if message:
                return


def look(place: Path, content: bytes) -> str | None:
    """Return what goes wrong with one file, None for nothing."""
    from rigel_k8s.cli.main import run

    (place / "Rigelfile").write_bytes(content)
    for command in COMMANDS:
        errors = io.StringIO()
        began = time.process_time()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            code = run(["-f", str(place / "Rigelfile"), command], "rigel")
        seconds = time.process_time() - began
        if code not in (0, 2) and not _needs_cluster(errors.getvalue()):
            return f"{command}: exit code {code}\n{errors.getvalue()[-1500:]}"
        if seconds > SECONDS:
            return f"{command}: takes more than {SECONDS:g} s"
        if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss > KILOBYTES:
            return f"{command}: takes more than {KILOBYTES // 1024} MB"
    return None


def _needs_cluster(errors: str) -> bool:
    """Return whether a job describes a part of a release, so that `render` asked the cluster."""
    return "Traceback" not in errors and "/nonexistent" in errors


def look_apart(content: bytes) -> str | None:
    """Return what goes wrong with a file, examined in a process of its own."""
    here, there = multiprocessing.Pipe()

    def send() -> None:
        with tempfile.TemporaryDirectory() as place:
            there.send(look(Path(place), content))

    worker = multiprocessing.get_context("fork").Process(target=send)
    worker.start()
    there.close()
    try:
        return str(here.recv() or "") if here.poll(DEADLINE) else "no end"
    except EOFError:
        return "died"
    finally:
        worker.kill()
        worker.join()


def fails_with(reason: str, content: bytes) -> bool:
    """Return whether a file goes wrong for the given reason."""
    return reason in (look_apart(content) or "")


def minimize(content: bytes, fails: Callable[[bytes], bool]) -> bytes:
    """Return a part of the lines that still fails, by leaving out one line after the other."""
    lines = content.splitlines(keepends=True)
    number = 0
    while number < len(lines) < 300:
        fewer = lines[:number] + lines[number + 1 :]
        if fails(b"".join(fewer)):
            lines = fewer
        else:
            number += 1
    return b"".join(lines)


if __name__ == "__main__":
    main()
