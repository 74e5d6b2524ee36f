"""What the layer costs a node for each message; prints a table.

usage: python -m bench.rmw [--times 200000] [--turns 10]

A middleware in memory stands for ROS 2's; publishing and taking with and without the layer take
turns, and the quickest turn of each counts, since a busy machine only adds.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.layer import Built, build


def measure(built: Built, times: int, notes: Path | None) -> tuple[float, ...]:
    """Return ns for publishing and for taking."""
    env = dict(os.environ)
    if notes:
        env |= {"LD_PRELOAD": str(built.preload), "RIGEL_RMW": str(notes)}
    lines = f"node n /\nmeasure {times}\n"
    done = subprocess.run(
        list(map(str, built.main)), input=lines, capture_output=True, text=True, check=True, env=env
    )
    return tuple(map(float, done.stdout.split("\n")[1].split()))


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=200_000)
    parser.add_argument("--turns", type=int, default=10)
    asked = parser.parse_args()
    found: dict[bool, list[tuple[float, ...]]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as room:
        built = build(Path(room))
        for turn in range(asked.turns):
            for layer in found:
                notes = Path(room, f"notes{turn}")
                notes.mkdir(exist_ok=True)
                found[layer].append(measure(built, asked.times, notes if layer else None))
    least = {layer: [min(row[i] for row in rows) for i in (0, 1)] for layer, rows in found.items()}
    sys.stdout.write("| | without | with the layer | added |\n|---|---|---|---|\n")
    for i, name in enumerate(("publish", "take")):
        without, with_layer = least[False][i], least[True][i]
        added = with_layer - without
        sys.stdout.write(f"| {name} | {without:.0f} ns | {with_layer:.0f} ns | {added:.0f} ns |\n")


if __name__ == "__main__":
    main()
