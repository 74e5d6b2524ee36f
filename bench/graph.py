"""The costs of a look at the DDS graph: time, packets, bytes for 3, 20, 50 pods on 3 machines.

Real ROS 2 nodes (Fast DDS) or Cyclone DDS in pods of namespaces, as in tests/ros2; needs root.
`python bench/graph.py [3 20 50]` prints the table of docs/graph.md.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from importlib import util
from pathlib import Path
from typing import Any

CONFTEST = Path(__file__).parents[1] / "tests" / "ros2" / "conftest.py"
MACHINES = ("one", "two", "three")


def laboratory() -> Any:
    """Provide the laboratory of the tests."""
    spec = util.spec_from_file_location("laboratory", CONFTEST)
    assert spec
    assert spec.loader
    module = util.module_from_spec(spec)
    sys.modules["laboratory"] = module
    spec.loader.exec_module(module)
    return module


def count_sent(lab: Any) -> tuple[int, int]:
    """Return the packets and bytes that all pods have sent on net1."""
    packets = octets = 0
    for pod in lab.pods.values():
        words = ["ip", "-n", pod.network, "-s", "-j", "link", "show", "net1"]
        (link,) = json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
        packets += link["stats64"]["tx"]["packets"]
        octets += link["stats64"]["tx"]["bytes"]
    return packets, octets


def measure_work(lab: Any, work: Any) -> tuple[float, int, int]:
    """Return the seconds, packets and bytes of a function."""
    before, started = count_sent(lab), time.monotonic()
    work()
    took, after = time.monotonic() - started, count_sent(lab)
    return took, after[0] - before[0], after[1] - before[1]


def measure(count: int, kind: str) -> str:
    """Return one line of the table."""
    module = laboratory()
    with ExitStack() as cleanup, tempfile.TemporaryDirectory() as folder:
        lab = module.Lab(Path(folder), cleanup, module.environment)
        start = lab.cyclone if kind == "Cyclone DDS" else lab.ros
        for number in range(count):
            start(f"pod_{number:02}", MACHINES[number % 3])
        lab.settle()
        time.sleep(20)  # they have discovered each other
        found: list[Any] = []
        took, packets, octets = measure_work(lab, lambda: found.append(lab.graph()))
        idle = measure_work(lab, lambda: time.sleep(took))
    complete = all(len(pod.discovered_by) == pod.out_of for pod in found[0].pods)
    extra = f"{packets - idle[1]} | {(octets - idle[2]) / 1000:.0f} kB | {idle[1]}"
    return f"| {kind} | {count} | {took:.1f} s | {extra} | {'all' if complete else 'not all'} |"


def main() -> None:
    """Print the table."""
    print("| DDS | pods | time | packets | bytes | without it in that time | discovered |")
    print("|---|---|---|---|---|---|---|")
    for count in map(int, sys.argv[1:] or ["3", "20", "50"]):
        for kind in ("Fast DDS", "Cyclone DDS"):
            print(measure(count, kind), flush=True)


if __name__ == "__main__":
    main()
