"""Pods that `network_policy` does not cover, or cuts off."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.network.mode import mode_path
from rigel_k8s.network.modes import mode_of
from rigel_k8s.problems import Path, Problem

ON_MACHINE = (
    "pods on the machine's own network are not covered by network_policy, and the other pods of the"
    " release refuse their connections: add the machines' addresses to network_policy.allow"
)
ATTACHED = (
    "network_policy covers only the pods' first interface: everything on the second network reaches"
    " all nodes there"
)
ELSEWHERE = (
    "nodes of this master that run elsewhere cannot connect to the nodes of this release: add their"
    " addresses or releases to network_policy.allow"
)


def check_network_policy(options: OrchestrationOptions) -> Iterator[Problem]:
    """Yield pods that no policy covers, or that a policy cuts off."""
    if options.network_policy is None:
        return
    mode = mode_of(options.network)
    addresses = any(source.cidr for source in options.network_policy.allow)
    if mode.attached:
        path: Path = ("network_policy",)
        yield Problem(path, ATTACHED, "not-covered", severity="warning", at_key=True)
    if options.ros_master_uri and not options.network_policy.allow:
        path = ("ros_master_uri",)
        yield Problem(path, ELSEWHERE, "not-covered", severity="warning", at_key=True)
    if addresses:
        return
    if options.network is not None and mode.in_machine_network:
        path = mode_path(options.network)
        yield Problem(path, ON_MACHINE, "not-covered", severity="warning", at_key=True)
    for key, node in options.nodes.items():
        if node.host_network:
            path = ("nodes", str(key), "host_network")
            yield Problem(path, ON_MACHINE, "not-covered", severity="warning", at_key=True)
