"""A cluster whose pods are this machine: commands run here."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from rigel_graph.pods import GraphPod
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.execution import ExecResult

POD = GraphPod("here", "robots", "ros-master", "ros-node", running=True, ready=True)


class LocalCluster:
    """Runs what is to be run in a pod; `variables` are its environment besides PATH."""

    def __init__(self, **variables: str) -> None:
        self.variables = {"PATH": "/usr/local/bin:/usr/bin:/bin", **variables}
        self.pods: list[str] = []

    def run(
        self,
        namespace: str,
        pod: str,
        command: Sequence[str],
        *,
        container: str | None = None,
        stdin: bytes | None = None,
        timeout: float = 60.0,
    ) -> ExecResult:
        self.pods.append(pod)
        try:
            done = subprocess.run(
                command, input=stdin, capture_output=True, env=self.variables, timeout=timeout
            )
        except FileNotFoundError as error:  # in containerd's words
            text = f'exec: "{command[0]}": executable file not found in $PATH'
            raise ClusterError(text) from error
        return ExecResult(done.returncode, done.stdout, done.stderr)
