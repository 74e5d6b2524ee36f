"""Builds what the tests on a cluster need; the log has the minutes at which each step began.

`./run test` starts it beside the unit tests, and waits for it before the tests on a cluster.

usage: python -m tests.support.builds --proof | --all | --slow
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable

from rigel_lab.cluster import components

from .rust import Missing, rustdds_node

STARTED = time.monotonic()


def report(line: str) -> None:
    """Print a line with the minutes since the start."""
    print(f"{(time.monotonic() - STARTED) / 60:5.1f}  {line}", flush=True)  # noqa: T201


def programs(*requested: str) -> Callable[[], object]:
    """Return what builds a local cluster's programs."""
    return lambda: components.obtain(report, requested)


def image(*words: str) -> Callable[[], object]:
    """Return what builds an image."""
    command = [sys.executable, "-m", *words]
    return lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


#: What the proof needs.
PROOF: dict[str, Callable[[], object]] = {
    "the local cluster": programs("multus", "kubectl"),
    "the ROS 1 base image": image("rigel_k8s", "image", "ros1-base"),
    "the ROS 2 base image": image("rigel_lab", "ros2-base"),
    "the observability stack": programs("observability"),
    "the exporter's image": image("rigel_k8s", "image", "ros-exporter"),
}
#: What the other tests need besides.
ALL = PROOF | {
    "the node on RustDDS": rustdds_node,
    "a kubelet that says k3s": programs("k3s"),
    "Promtail and the Prometheus operator": programs("promtail", "prometheus-operator"),
    "the ROS 2 base image, kilted": image("rigel_lab", "ros2-base", "--distro", "kilted"),
    "the image of Muto's agent": image("rigel_k8s", "image", "muto-agent"),
}


def main() -> None:
    """Build everything; what fails is the failure of the tests that need it."""
    wanted = PROOF if "--proof" in sys.argv else ALL
    for what, step in wanted.items():
        report(what)
        try:
            step()
        except (Missing, Exception) as error:
            report(f"{what}: {error}")
    report("all is built")


if __name__ == "__main__":
    main()
