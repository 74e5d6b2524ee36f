"""Builds what the tests on a cluster need; the log has the minutes at which each step began.

`./run test` starts it beside the unit tests, and waits for it before the tests on a cluster.

usage: python -m tests.support.builds --proof | --all | --slow
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

from rigel_k8s.cli.reports import Lines
from rigel_lab.cluster import components
from rigel_lab.images import ros1base

from . import arm64
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


def ros1(**options: Any) -> None:
    """Build a ROS 1 base image, for the cache alone.

    In podman one for arm64 would have the name of this machine's.
    """
    ros1base.build(Lines(quiet=True), **options)


def for_arm64() -> None:
    """Build what tests of arm64 need, where its programs run: QEMU takes ten minutes for some."""
    if arm64.possible():
        arm64.build_containerd()
        with arm64.emulated():
            ros1(arch="arm64")


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
    "the ROS 1 base image with a compiler": lambda: ros1(variant="devel"),
    "containerd and the ROS 1 base image for arm64": for_arm64,
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
