"""Runs a program with the modules that it needs in a pod, and returns the JSON that it prints.

Why: the modules are sent with the request, so that a graph can be read from a release that an older
version deployed, without a new ConfigMap and without a restart of its pods. Nothing is
written in the pod: the modules arrive on standard input, as one line, and are imported from memory.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import explain_exec
from rigel_k8s.rosgraph.pods import GraphPod

LIMIT = 45.0  # seconds that a program may take, with every deadline in it missed

#: Python 2.7 and 3: makes modules from standard input, and runs the last one.
LOADER = """
import base64, json, sys, types, zlib
line = sys.stdin.readline()
sent = json.loads(zlib.decompress(base64.b64decode(line)).decode("utf-8"))
texts = dict(sent)
packages = {name.rpartition(".")[0] for name in texts}
def make(name):
    module = types.ModuleType(str(name))
    module.__package__ = str(name if name in packages else name.rpartition(".")[0])
    if name in packages:
        module.__path__ = []
    sys.modules[str(name)] = module
    exec(compile(texts[name], "<%s>" % name, "exec"), module.__dict__)
    if "." in name:
        parent, _, own = name.rpartition(".")
        setattr(sys.modules[parent], own, module)
for name, _ in sent[:-1]:
    make(name)
exec(compile(sent[-1][1], "<rigel-k8s>", "exec"), {"__name__": "__main__"})
"""

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
    packed = base64.b64encode(zlib.compress(json.dumps(modules).encode())) + b"\n"
    try:
        done = cluster.run(
            pod.namespace, pod.name, command, container=pod.container, stdin=packed, timeout=LIMIT
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


def read_module(name: str) -> str:
    """Return the text of a module of this package."""
    package, _, module = name.rpartition(".")
    return (files(package) / f"{module}.py").read_text(encoding="utf-8")
