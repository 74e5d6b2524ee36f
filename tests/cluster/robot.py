"""A ROS 1 application for tests: a Rigelfile in a directory, and rigel at work on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


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
        jobs = {
            "deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job},
            "update": {
                "plugin": "src.plugin.OrchestrationPlugin",
                "with": {
                    "orchestration": {
                        "rolling_update": {
                            "strategy": "Rolling",
                            "max_surge": 1,
                            "max_unavailable": 0,
                        }
                    }
                },
            },
        }
        self.file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))

    def rigel(self, *words: str, **options: Any) -> Any:
        """Run rigel on the Rigelfile."""
        return self._rigel("-f", str(self.file), "-n", self.namespace, *words, **options)

    def deploy(self) -> None:
        """Run the job that deploys."""
        self.rigel("run", "job", "deploy", "--timeout", "2m")

    def pods(self, name: str) -> list[dict[str, Any]]:
        """Return a workload's pods that are not on their way out."""
        found = self.cluster.list(
            "v1", "Pod", self.namespace, labels={"app.kubernetes.io/name": name}
        )
        return [pod for pod in found if not pod["metadata"].get("deletionTimestamp")]

    def ready(self, name: str) -> bool:
        """Return whether all of a workload's pods are ready."""
        return all(
            condition["status"] == "True"
            for pod in self.pods(name)
            for condition in pod["status"].get("conditions", [])
            if condition["type"] == "Ready"
        )

    def run(self, name: str, *command: str) -> str:
        """Run a command in a workload's pod and return what it printed."""
        pod = self.pods(name)[0]
        full = ["/bin/sh", "/rigel-k8s/exec.sh", *command]
        container = pod["spec"]["containers"][0]["name"]
        done = self.cluster.run(self.namespace, pod["metadata"]["name"], full, container=container)
        assert done.code == 0, done.stderr.decode()
        return str(done.stdout.decode())

    def deployments(self) -> set[str]:
        """Return the names of the namespace's Deployments."""
        found = self.cluster.list("apps/v1", "Deployment", self.namespace)
        return {item["metadata"]["name"] for item in found}
