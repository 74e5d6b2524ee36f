"""A release that is deployed repeatedly on a local cluster, by `rigel` as users run it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_lab import cluster as lab

#: The bench's own cluster, by ROS.
OWN = {"1": "rigel-bench", "2": "rigel-bench2"}
#: Seconds until something must be noticed.
PATIENCE = 30.0


@attrs.frozen
class Rollouts:
    """A namespace, and where the Rigelfile is written.

    Attributes:
        image: ROS' base image, in the cluster's registry.
        program: the command `rigel`.
    """

    context: str
    kubectl_program: str
    image: str
    namespace: str
    directory: Path
    program: Sequence[str] = (sys.executable, "-m", "rigel_k8s")

    def kubectl(self, *words: str) -> str:
        """Run kubectl in the namespace."""
        head = [self.kubectl_program, "--context", self.context, "-n", self.namespace]
        done = subprocess.run([*head, *words], capture_output=True, text=True, check=True)
        return done.stdout

    def clear(self) -> None:
        """Delete the namespace and create it again."""
        self.kubectl("delete", "namespace", self.namespace, "--ignore-not-found", "--wait")
        self.kubectl("create", "namespace", self.namespace)

    def deploy(
        self,
        distro: str,
        nodes: Mapping[str, Any],
        more: Mapping[str, Any],
        timeout: str = "60s",
    ) -> bool:
        """Deploy nodes, with more options of the job; return whether all became ready."""
        options = {"namespace": self.namespace, "image": self.image, "nodes": nodes, **more}
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        file = self.directory / "Rigelfile"
        file.write_text(json.dumps({"application": {"distro": distro}, "jobs": {"deploy": job}}))
        head = [*self.program, "-f", str(file), "--context", self.context]
        words = ["run", "job", "deploy", "--timeout", timeout]
        return subprocess.run([*head, *words], capture_output=True).returncode == 0

    def logs(self, workload: str) -> str:
        """Return what a workload's pod has printed."""
        return self.kubectl("logs", f"deployment/{workload}", "--tail=-1")


def find_cluster(context: str | None, ros: str) -> tuple[str, str, str]:
    """Return (context, kubectl, base image); without a context the bench's own cluster is started.

    Args:
        ros: 1 or 2.
    """
    found = context or OWN[ros]
    name = found.removeprefix("rigel-")
    rigel = [sys.executable, "-m", "rigel_k8s", "--context", found]
    if not context:
        extras = ["kubectl"] if ros == "1" else ["kubectl", "multus"]
        lab.up(name, 2, extras=extras, report=print)
    if ros == "2":
        subprocess.run([*rigel, "network", "install"], check=True)
    status = lab.status(name)
    image = f"{status.registry}/ros:{'noetic' if ros == '1' else 'jazzy'}"
    words = ["rigel_k8s", "image", "ros1-base"] if ros == "1" else ["rigel_lab", "ros2-base"]
    subprocess.run([sys.executable, "-m", *words, "--push", image], check=True)
    return found, status.kubectl, image


def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition holds, at most PATIENCE."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and not condition():
        time.sleep(0.3)


def numbers(text: str) -> list[int]:
    """Return the numbers in an option such as `20,100`."""
    return [int(word) for word in text.split(",")]
