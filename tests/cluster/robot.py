"""A ROS 1 application for tests: a Rigelfile in a directory, and rigel at work on it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rigel_k8s.objects.facts import is_ready
from tests.support.until import until

#: Seconds that a command in a pod has: on a busy machine a ROS tool takes many to start.
PATIENCE = 180


class Robot:
    """A Rigelfile in a directory of its own, and rigel at work on it."""

    def __init__(
        self, directory: Path, namespace: str, image: str, rigel: Any, cluster: Any
    ) -> None:
        self.file = directory / "Rigelfile"
        self.namespace = namespace
        self.image = image
        self.cluster = cluster
        self._rigel = rigel

    def write(self, nodes: dict[str, Any], /, **options: Any) -> None:
        """Write a Rigelfile (JSON is YAML) with these nodes; `image` is the base image."""
        job = {
            "namespace": self.namespace,
            "ros_master_image": self.image,
            "image": self.image,
            "nodes": nodes,
            **options,
        }
        jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
        self.file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))

    def rigel(self, *words: str, **options: Any) -> Any:
        """Run rigel on the Rigelfile."""
        return self._rigel("-f", str(self.file), "-n", self.namespace, *words, **options)

    def deploy(self) -> None:
        """Run the job that deploys.

        On an overloaded machine a node's first packet to a new Service may be lost, which the
        kernel notices after 133 s.
        """
        self.rigel("run", "job", "deploy", "--timeout", "4m")

    def pods(self, name: str) -> list[dict[str, Any]]:
        """Return a workload's pods that are not on their way out."""
        found = self.every_pod(name)
        return [pod for pod in found if not pod["metadata"].get("deletionTimestamp")]

    def every_pod(self, name: str) -> list[dict[str, Any]]:
        """Return a workload's pods, those on their way out too."""
        labels = {"app.kubernetes.io/name": name}
        found: list[dict[str, Any]] = self.cluster.list("v1", "Pod", self.namespace, labels=labels)
        return found

    def ready(self, name: str) -> bool:
        """Return whether a workload has pods and all of them are ready."""
        pods = self.pods(name)
        return bool(pods) and all(is_ready(pod) for pod in pods)

    def run(self, name: str, *command: str) -> str:
        """Run a command in a workload's pod and return what it printed."""
        done = self._exec(name, command)
        assert done.code == 0, done.stderr.decode()
        return str(done.stdout.decode())

    def until_master_answers(self, name: str) -> None:
        """Wait until a workload's pod reaches ros-master: its Service follows the pod later."""
        command = ("rosparam", "get", "/run_id")
        answers = f"an answer of ros-master to {name}"
        until(lambda: self._exec(name, command).code == 0, answers, 120)

    def _exec(self, name: str, command: Sequence[str]) -> Any:
        pod = self.pods(name)[0]
        full = ["/bin/sh", "/rigel-k8s/exec.sh", *command]
        container = pod["spec"]["containers"][0]["name"]
        return self.cluster.run(
            self.namespace, pod["metadata"]["name"], full, container=container, timeout=PATIENCE
        )

    def deployments(self) -> set[str]:
        """Return the names of the namespace's Deployments."""
        found = self.cluster.list("apps/v1", "Deployment", self.namespace)
        return {item["metadata"]["name"] for item in found}
