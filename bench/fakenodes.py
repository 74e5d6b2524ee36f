"""Machines that exist only in the API: KWOK makes pods on them ready at once and runs nothing.

So two cores carry thousands of pods, and only the work of a tool and the API server is measured.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.requests import call
from bench.tools import BenchBuild
from rigel_lab.cluster.certificates import Authority

STAGES = {
    "node-initialize.yaml": "kustomize/stage/node/fast/node-initialize.yaml",
    "pod-ready.yaml": "kustomize/stage/pod/fast/pod-ready.yaml",
    "pod-complete.yaml": "kustomize/stage/pod/fast/pod-complete.yaml",
    "pod-delete.yaml": "kustomize/stage/pod/fast/pod-delete.yaml",
}
KWOK = BenchBuild("kwok", "0.8.0", ("sigs.k8s.io/kwok/cmd/kwok",), files=STAGES, minutes=2)
#: Under load, fake machines may turn unready for a moment: their pods become ready again.
AGAIN = ("- 'Pending'", "- 'Pending'\n      - 'Running'")
#: The mark of a machine that KWOK simulates.
FAKE = "kwok.x-k8s.io/node"
PORT = 10247
#: The log of each container, in the format of a container runtime.
LINE = "2026-01-01T00:00:00.000000000Z stdout F it runs\n"
CONFIGURATION = """\
apiVersion: config.kwok.x-k8s.io/v1alpha1
kind: KwokConfiguration
options:
  manageAllNodes: false
  manageNodesWithAnnotationSelector: {fake}=fake
  nodeLeaseDurationSeconds: 40
  enableDebuggingHandlers: true
  nodeLeaseParallelism: 4
  nodePlayStageParallelism: 4
  podPlayStageParallelism: 8
---
apiVersion: kwok.x-k8s.io/v1alpha1
kind: ClusterLogs
metadata: {{name: all}}
spec:
  logs:
  - logsFile: {log}
    follow: true
"""


@contextlib.contextmanager
def fake_machines(kubectl: list[str], count: int, address: str) -> Iterator[None]:
    """Simulate machines, and keep pods away from the real ones meanwhile.

    Args:
        kubectl: its command line as far as the context.
        address: this machine's, where the API server asks for the logs of containers.
    """
    KWOK.build(print)
    real = names(kubectl, f"!{FAKE}")
    with tempfile.TemporaryDirectory() as directory, controller(kubectl, Path(directory), address):
        try:
            create(kubectl, count)
            for name in real:
                call(kubectl, "cordon", name)
            yield
        finally:
            for name in real:
                call(kubectl, "uncordon", name)
            call(kubectl, "delete", "nodes", "-l", FAKE, "--wait=false")


@contextlib.contextmanager
def controller(kubectl: list[str], directory: Path, address: str) -> Iterator[None]:
    """Run KWOK's controller; its log is written to standard error when it ends too early."""
    logs, own = directory / "logs", directory / "kwok.yaml"
    logs.mkdir()  # a directory of its own: a change beside a log wakes all that follow it
    log = logs / "container.log"
    log.write_text(LINE)
    programs = KWOK.programs()
    stages = [Path(programs[name]).read_text().replace(*AGAIN) for name in STAGES]
    own.write_text("\n---\n".join([CONFIGURATION.format(fake=FAKE, log=log), *stages]))
    kubeconfig = directory / "kubeconfig"
    flat = call(kubectl, "config", "view", "--minify", "--flatten")
    kubeconfig.write_text(flat)
    certificate, key = Authority(directory / "pki").issue(
        "kubelet", "kubelet", alternatives=[f"IP:{address}"]
    )
    command = [programs["kwok"], f"--config={own}", f"--kubeconfig={kubeconfig}"]
    command += [f"--node-ip={address}", f"--node-port={PORT}"]
    command += [f"--tls-cert-file={certificate}", f"--tls-private-key-file={key}"]
    with (directory / "kwok.log").open("w+") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output)
        try:
            yield
            if process.poll() is not None:
                output.seek(0)
                raise SystemExit(f"KWOK has ended:\n{output.read()}")
        finally:
            process.terminate()
            process.wait()


def create(kubectl: list[str], count: int, seconds: float = 60) -> None:
    """Create machines and wait until all are ready."""
    items = [
        {
            "apiVersion": "v1",
            "kind": "Node",
            "metadata": {
                "name": f"fake-{index:03}",
                "annotations": {FAKE: "fake"},
                "labels": {FAKE: "fake", "kubernetes.io/hostname": f"fake-{index:03}"},
            },
        }
        for index in range(count)
    ]
    call(
        kubectl,
        "apply",
        "-f",
        "-",
        text=json.dumps({"kind": "List", "apiVersion": "v1", "items": items}),
    )
    call(kubectl, "wait", "nodes", "-l", FAKE, "--for=condition=Ready", f"--timeout={seconds:g}s")
    time.sleep(2)  # until the scheduler has noticed them


def names(kubectl: list[str], selector: str) -> list[str]:
    """Return the names of the machines with some labels."""
    return call(kubectl, "get", "nodes", "-l", selector, "-o", "name").split()
