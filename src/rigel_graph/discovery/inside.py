"""Runs programs with the modules that they need in a pod, and returns the JSON that they print.

Why: the modules are sent with the request (rigel_inpod.sent), so that a graph can be read from a
release that an older version deployed, without a new ConfigMap and without a restart of its pods.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from rigel_graph.discovery.members import Member
from rigel_inpod.sent import LOADER, choose_python, pack, read_module
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import explain_exec
from rigel_k8s.network.modes import mode_named

#: The modules that are sent, each after those that it imports.
MODULES = (
    *(f"rigel_inpod.{name}" for name in ("rtps", "spdp", "interfaces")),
    *(
        f"rigel_exporter.{name}"
        for name in (
            *("messages", "samples", "graph", "dds_names", "dds_discovery", "dds_wire"),
            *("dds_reliable", "dds_peer", "dds_participant", "dds_view"),
            *("dds_ways", "dds"),
        )
    ),
    "rigel_exporter.dds_graph",
)
PACKAGES = ("rigel_inpod", "rigel_exporter")
LIMIT = 45.0  # seconds that a program may take, with every deadline in it missed


class Place(Protocol):
    """A container of a pod."""

    @property
    def namespace(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def container(self) -> str: ...


class Unread(ClusterError):
    """Nothing could be read in a pod; `reason` says why, without the pod."""

    def __init__(self, pod: str, reason: str) -> None:
        super().__init__(f"cannot read the ROS graph in the pod {pod}: {reason}")
        self.reason = reason


def run_inside(
    cluster: Cluster,
    pod: Place,
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
        Unread: nothing can be run in the pod, or the program failed.
    """
    command = [pythons[0], "-S", "-E", "-B", "-c", LOADER, *arguments]
    if len(pythons) > 1:
        command = choose_python(pythons, LOADER, *arguments)
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
        raise Unread(pod.name, explain_exec(error)) from error
    lines = done.stdout.decode("utf-8", "replace").splitlines()
    if done.code != 0 or not lines:
        errors = done.stderr.decode("utf-8", "replace").splitlines()
        why = errors[-1] if errors else f"exit code {done.code}"
        raise Unread(pod.name, why)
    answer: Mapping[str, Any] = json.loads(lines[-1])
    if "error" in answer:
        raise Unread(pod.name, str(answer["error"]))
    return answer


def read_notes(cluster: Cluster, pod: Place, span: float = 0.0) -> Mapping[str, Any]:
    """Return what the ROS 2 processes of a pod have noted: `first`, and `second` a span later.

    Raises:
        Unread: it cannot be read.
    """
    modules = [
        ("rmw_notes", read_module("rigel_inpod.rmw_notes")),
        ("notes", read_module("rigel_inpod.sent.notes")),
    ]
    return run_inside(cluster, pod, modules, [str(span)])


def listen(cluster: Cluster, pod: Place, config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what a participant in a pod hears of DDS discovery within seconds.

    Raises:
        Unread: it cannot be read, for example because its Python is older than 3.9.
    """
    modules = [(name, "") for name in PACKAGES] + [(name, read_module(name)) for name in MODULES]
    return run_inside(cluster, pod, modules, [json.dumps(config)])


def choose_domain(members: Iterable[Member]) -> int:
    """Return the domain that most nodes are in; 0 if their images decide."""
    counts = Counter(member.domain or 0 for member in members)
    return counts.most_common(1)[0][0]


def configure(members: Sequence[Member], domain: int) -> dict[str, Any]:
    """Return the arguments of the exporter's Domain, to join discovery as the nodes do."""
    first = next(member for member in members if (member.domain or 0) == domain)
    config: dict[str, Any] = {"domain": domain, "mode": "multicast"}
    if first.interface:
        config["interface"] = first.interface
    workloads = [member.workload for member in members]
    return {**config, **mode_named(first.mode).join_seen(workloads, first.servers)}
