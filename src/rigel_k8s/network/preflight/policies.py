"""Warns of NetworkPolicies that select pods of the release and do not apply to its network."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.network.preflight.case import Case
from rigel_k8s.network.preflight.finding import PreflightKind, list_some
from rigel_k8s.objects.scheduling import is_selected
from rigel_k8s.problems import Problem

NETWORK_POLICY = PreflightKind(
    "network-policy",
    "a NetworkPolicy selects pods of the release, and does not cover the second interface"
    " (nor `host`)",
    "warning",
    "NetworkPolicies of the namespace",
)


def policies(case: Case) -> Iterator[Problem]:
    """Yield NetworkPolicies that select our pods: they do not apply to a second network."""
    found: dict[str, None] = {}
    for policy in case.view.policies:
        selector = (policy.get("spec") or {}).get("podSelector") or {}
        for pod in case.wanted:
            if pod.pods and is_selected(selector, pod.labels):
                found[policy["metadata"]["name"]] = None
    if not found:
        return
    host = not case.keys
    where = "the machine's network (`mode: host`)" if host else "the second interface"
    yield NETWORK_POLICY.problem(
        f"NetworkPolicy {list_some(found)} selects pods of this release and does not cover {where}",
        "every device on that network reaches all their ports: separate it with a VLAN or the"
        " machines' firewall" + ("" if host else ", or use MultiNetworkPolicy"),
    )
