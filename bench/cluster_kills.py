"""What `rigel cluster up` leaves that is killed: the same command must complete it.

usage: python -m bench.cluster_kills [--kills 50] [--seed 0]

Each time `up` of a new cluster gets SIGKILL at a random moment of its work. Then the same command
must end well and say of the cluster that all runs, and `down` must leave no process, mount,
interface or directory. Needs root; prints one line for each kill.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rigel_lab.cluster.paths import directory_of

NAME = "bench-kills"


def rigel(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command on the cluster."""
    line = [sys.executable, "-m", "rigel_k8s", "cluster", *words, "--name", NAME]
    return subprocess.run(line, capture_output=True, text=True, check=False, timeout=600)


def snapshot() -> set[str]:
    """Return what the machine has that a cluster adds to."""
    mounts = {line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()}
    programs = set()
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = process.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        programs |= {line} if NAME in line and "rigel_k8s cluster" not in line else set()
    return mounts | programs | {link.name for link in Path("/sys/class/net").iterdir()}


def kill(longest: float, dice: random.Random) -> float:
    """Start `up`, and kill it after a random time; return that time."""
    line = [sys.executable, "-m", "rigel_k8s", "cluster", "up", "--name", NAME, "--nodes", "1"]
    quiet = subprocess.DEVNULL
    seconds = dice.uniform(0.2, longest)
    with subprocess.Popen(line, stdout=quiet, stderr=quiet, start_new_session=True) as process:
        time.sleep(seconds)
        process.kill()
    return seconds


def main() -> None:
    """Kill, complete, remove; print what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    words = parser.parse_args()
    dice, bad = random.Random(words.seed), 0
    with tempfile.TemporaryDirectory() as place:
        os.environ["KUBECONFIG"] = f"{place}/config"
        rigel("down")
        before, began = snapshot(), time.monotonic()
        whole = rigel("up", "--nodes", "1")
        longest = time.monotonic() - began
        assert whole.returncode == 0, whole.stderr
        rigel("down")
        for number in range(1, words.kills + 1):
            seconds = kill(longest, dice)
            done = rigel("up", "--nodes", "1")
            status = rigel("status", "-o", "json")
            problems = json.loads(status.stdout or "{}").get("problems", [status.stderr])
            gone = rigel("down")
            left = sorted(snapshot() - before)
            left += [str(directory_of(NAME))] if directory_of(NAME).exists() else []
            wrong = done.returncode or gone.returncode or problems or left
            bad += bool(wrong)
            print(f"{number}: killed after {seconds:.1f} s of {longest:.1f}: ", end="")
            print((done.stderr, problems, gone.stderr, left) if wrong else "good", flush=True)
        print(f"{words.kills} kills, {bad} of them not completed")


if __name__ == "__main__":
    main()
