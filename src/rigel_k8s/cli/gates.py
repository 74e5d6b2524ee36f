"""The state of roscore's gate, as lines below the status table."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import urlsplit

from rigel_k8s.release.status import ReleaseStatus
from rigel_k8s.rosgraph.handover import GateStatus


def gate_lines(gate: GateStatus, found: ReleaseStatus) -> Iterator[str]:
    """Yield lines for users: calls that wait, what was lost, nodes that wait or are silent."""
    pods = {pod.ip: pod.name for workload in found.workloads for pod in workload.pods if pod.ip}

    def place(api: str) -> str:
        host = urlsplit(api).hostname or api
        return f"pod {pods[host]}" if host in pods else f"{host} (no pod of this release)"

    if gate.problem:
        yield f"cannot reach the gate in front of roscore: {gate.problem}"
        return
    if gate.blocked:
        yield f"{gate.blocked}; calls to the master wait until it succeeds"
    elif not gate.has_master:
        yield "roscore does not answer its gate; calls to the master wait until it does"
    for refusal in gate.refused:
        yield f"roscore did not accept again the {refusal}; restart the pod of its node"
    for why in gate.unkept:
        yield f"{why}; a new ros-master pod would not have the latest registrations and parameters"
    for node in gate.waiting:
        behind = f"take over from {place(node.owner)}" if node.owner else "have its name"
        yield f"{node.node}: {place(node.api)} waits to {behind}"
    for one in gate.conflicts:
        when = (
            f"{one.seconds:.0f} s ago" if one.seconds < 120 else f"{one.seconds / 60:.0f} min ago"
        )
        yield (
            f"{one.node}: {place(one.old)} lost its name to {place(one.new)} {when}; ROS 1 allows"
            " one node of a name: stop one of the two, or rename it"
        )
    for name in gate.silent:
        yield f"{name} has not answered since roscore restarted; it is registered once it does"
