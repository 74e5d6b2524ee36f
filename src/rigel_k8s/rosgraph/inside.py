"""Runs a program with the modules that it needs in a pod, and returns the JSON that it prints.

Why: the modules are sent with the request (rigel_inpod.sent), so that a graph can be read from a
release that an older version deployed, without a new ConfigMap and without a restart of its pods.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from rigel_inpod.sent import LOADER, pack, read_module
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import explain_exec
from rigel_k8s.rosgraph.pods import GraphPod

__all__ = ["read_module", "run_inside"]

LIMIT = 45.0  # seconds that a program may take, with every deadline in it missed

#: Tries the Pythons of images of different ages, as the probes do.
SHELL = """
for python in %s; do
  command -v "$python" >/dev/null 2>&1 && exec "$python" -S -E -B -c "$0" "$@"
done
echo 'its image has no %s' >&2
exit 127
"""


def run_inside(
    cluster: Cluster,
    pod: GraphPod,
    modules: Sequence[tuple[str, str]],
    arguments: Sequence[str] = (),
    *,
    pythons: Sequence[str] = ("python3",),
) -> Mapping[str, Any]:
    """Return the output of a program in a pod.

    Args:
        modules: (import name, text), each after those that it imports; the last is run.
        pythons: the interpreters to try; a shell in the image chooses between several.

    Raises:
        ClusterError: nothing can be run in the pod, or the program failed.
    """
    command = [pythons[0], "-S", "-E", "-B", "-c", LOADER, *arguments]
    if len(pythons) > 1:
        command = ["/bin/sh", "-c", SHELL % (" ".join(pythons), pythons[-1]), LOADER, *arguments]
    try:
        done = cluster.run(
            pod.namespace,
            pod.name,
            command,
            container=pod.container,
            stdin=pack(modules),
            timeout=LIMIT,
        )
    except ClusterError as error:
        raise ClusterError(
            f"cannot read the ROS graph in the pod {pod.name}: {explain_exec(error)}"
        ) from error
    lines = done.stdout.decode("utf-8", "replace").splitlines()
    if done.code != 0 or not lines:
        errors = done.stderr.decode("utf-8", "replace").splitlines()
        why = errors[-1] if errors else f"exit code {done.code}"
        raise ClusterError(f"cannot read the ROS graph in the pod {pod.name}: {why}")
    answer: Mapping[str, Any] = json.loads(lines[-1])
    if "error" in answer:
        raise ClusterError(f"cannot read the ROS graph in the pod {pod.name}: {answer['error']}")
    return answer
