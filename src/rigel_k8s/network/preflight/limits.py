"""Warnings: limits because of which messages may be lost, and policies that do not apply."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rigel_k8s.network.preflight.case import Case
from rigel_k8s.network.preflight.finding import PreflightFinding, list_some
from rigel_k8s.network.preflight.wanted import is_selected

#: A message of 1 MB that arrives at once in fragments of 64 KB is lost in a buffer of 416 KiB and
#: fits into one of 1 MiB (docs/preflight.md: how it was measured).
LEAST = 1024 * 1024
ADVISED = 8 * 1024 * 1024
BUFFERS = ("net.core.rmem_max", "net.core.wmem_max")
FILE = "/etc/sysctl.d/60-ros.conf"
ROOM = 4  # times what is needed
#: The maximum size of the kernel's table of neighbors, which all pods of a machine share.
NEIGHBOURS = "net.ipv4.neigh.default.gc_thresh3"


def buffers(case: Case) -> Iterator[PreflightFinding]:
    """Yield machines whose socket buffers or fragment memory are small for large messages."""
    users = case.nodes()
    seen = {node: facts for node, facts in case.view.machines.items() if node in users}
    small = {
        node: ", ".join(f"{n} {facts.settings[n]}" for n in BUFFERS if _is_small(facts.settings, n))
        for node, facts in seen.items()
    }
    nodes = [node for node, text in small.items() if text]
    if nodes:
        settings = " ".join(f"{name}={ADVISED}" for name in BUFFERS)
        yield PreflightFinding(
            "small-buffers",
            f"messages of 1 MB and more may be lost on {list_some(nodes)}: {small[nodes[0]]}",
            f"run `sysctl -w {settings}` on the machine (not in a pod), and write it to {FILE}",
            severity="warning",
        )
    yield from _fragments(case)


def _is_small(settings: Mapping[str, int], name: str) -> bool:
    return settings.get(name, LEAST) < LEAST


def _fragments(case: Case) -> Iterator[PreflightFinding]:
    """Yield machines with wireless networks that keep incomplete messages for half a minute.

    Pods with a network of their own have the kernel's defaults, not the machine's settings.
    """
    if not any(pod.spec.get("hostNetwork") for pod in case.wanted):
        return
    nodes = [
        node
        for node in case.nodes()
        if node in case.view.machines
        and any(i.wireless and i.up for i in case.view.machines[node].interfaces.values())
        and case.view.machines[node].settings.get("net.ipv4.ipfrag_time", 0) >= 30
        and case.view.machines[node].settings.get("net.ipv4.ipfrag_high_thresh", 0) <= 4 * LEAST
    ]
    if nodes:
        yield PreflightFinding(
            "fragments",
            f"on the wireless network of {list_some(nodes)}, lost fragments may block large"
            " messages for 30 s",
            "run `sysctl -w net.ipv4.ipfrag_time=3 net.ipv4.ipfrag_high_thresh=134217728` on the"
            f" machine, and write it to {FILE}",
            severity="warning",
        )


def neighbours(case: Case) -> Iterator[PreflightFinding]:
    """Yield machines whose table of neighbors is small for pods that all send to each other."""
    for one in case.attachments:
        pods, nodes = case.pods(one), case.nodes(case.users(one))
        needed = -(-pods // max(1, len(nodes))) * (pods - 1)  # spread evenly
        small = {
            node: facts.settings[NEIGHBOURS]
            for node, facts in case.machines(one)
            if facts.settings.get(NEIGHBOURS, needed) < needed
        }
        if small:
            yield PreflightFinding(
                "neighbours",
                f"{pods} pods on {len(nodes)} machines that send to each other need about"
                f" {needed} neighbors on each, and {list_some(small)} can keep"
                f" {min(small.values())} ({NEIGHBOURS}) for all pods together: packets to others"
                " are dropped silently",
                f"run `sysctl -w {NEIGHBOURS}={ROOM * needed}` on the machine, and write it to"
                f" {FILE}",
                severity="warning",
            )


def policies(case: Case) -> Iterator[PreflightFinding]:
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
    yield PreflightFinding(
        "network-policy",
        f"NetworkPolicy {list_some(found)} selects pods of this release and does not cover {where}",
        "every device on that network reaches all their ports: separate it with a VLAN or the"
        " machines' firewall" + ("" if host else ", or use MultiNetworkPolicy"),
        severity="warning",
    )
