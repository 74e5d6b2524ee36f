"""NetworkPolicies, enforced on the machines of a local cluster by nft.

The local cluster's network enforces none. This is the part of the standard that `rigel` uses: who
may connect, by labels of pods, names of namespaces, addresses and ports. Anything else is an error.
"""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import attrs

TABLE = "rigel_policies"
NAME = "kubernetes.io/metadata.name"
#: Seconds between two looks at the cluster.
EVERY = 0.5

Object = Mapping[str, Any]


def rules(policies: Sequence[Object], pods: Sequence[Object]) -> str:
    """Return the nft rules of a machine: a pod that a policy selects hears only who is admitted.

    Args:
        pods: with an address, and none of them in its machine's network.
    """
    chains, jumps = [], []
    for number, pod in enumerate(pods):
        own = [policy["spec"] for policy in policies if selects(policy, pod)]
        if not own:
            continue
        assert all(spec["policyTypes"] == ["Ingress"] for spec in own)
        lines = [
            line
            for spec in own
            for rule in spec.get("ingress", ())
            for line in admit(rule, pod, pods)
        ]
        chains.append("\n".join([f"chain pod{number} {{", *lines, "drop", "}"]))
        jumps.append(f"ip daddr {address(pod)} jump pod{number}")
    hook = ["type filter hook forward priority 0;", "ct state established,related accept"]
    table = f"table inet {TABLE}"
    renewed = [f"{table} {{}}", f"delete {table}", f"{table} {{"]
    return "\n".join([*renewed, *chains, "chain forward {", *hook, *jumps, "}", "}", ""])


def admit(rule: Object, pod: Object, pods: Sequence[Object]) -> Iterator[str]:
    """Yield the nft rules of one rule of a policy."""
    found = [source for peer in rule["from"] for source in sources(peer, pod, pods)]
    ports = [f"{p['protocol'].lower()} dport {p['port']} " for p in rule.get("ports", [])] or [""]
    for port in ports:
        for source in dict.fromkeys(found):
            yield f"ip saddr {source} {port}accept"


def sources(peer: Object, pod: Object, pods: Sequence[Object]) -> Iterator[str]:
    """Yield the addresses that a peer of a policy stands for."""
    if "ipBlock" in peer:
        yield peer["ipBlock"]["cidr"]
        return
    assert set(peer) <= {"podSelector", "namespaceSelector"}, peer
    for other in pods:
        space = other["metadata"]["namespace"]
        same = space == pod["metadata"]["namespace"]
        if "namespaceSelector" in peer:
            same = matches(peer["namespaceSelector"], {NAME: space})
        if same and matches(peer.get("podSelector", {}), other["metadata"].get("labels", {})):
            yield address(other)


def selects(policy: Object, pod: Object) -> bool:
    """Return whether a policy is about a pod."""
    meta = pod["metadata"]
    same = policy["metadata"]["namespace"] == meta["namespace"]
    return same and matches(policy["spec"]["podSelector"], meta.get("labels", {}))


def matches(selector: Object, labels: Mapping[str, str]) -> bool:
    """Return whether labels are those that a selector asks for."""
    assert set(selector) <= {"matchLabels"}, selector
    return selector.get("matchLabels", {}).items() <= labels.items()


def address(pod: Object) -> str:
    """Return a pod's address."""
    return str(pod["status"]["podIP"])


@attrs.define
class Enforcer:
    """Keeps the rules of a local cluster's machines as its policies are."""

    cluster: Any
    name: str
    ended: threading.Event = attrs.field(factory=threading.Event)
    applied: str = ""

    def step(self) -> None:
        """Apply the rules if they have changed."""
        policies = self.cluster.list("networking.k8s.io/v1", "NetworkPolicy")
        pods = [
            pod
            for pod in self.cluster.list("v1", "Pod")
            if pod["status"].get("podIP") and not pod["spec"].get("hostNetwork")
            if pod["status"]["phase"] in ("Pending", "Running")
        ]
        text = rules(policies, sorted(pods, key=address))
        if text != self.applied:
            self.nft(text)
            self.applied = text

    def run(self) -> None:
        """Step until it is ended."""
        while not self.ended.wait(EVERY):
            self.step()

    def nft(self, text: str) -> None:
        """Run nft on all machines."""
        for machine in self.machines():
            words = ["ip", "netns", "exec", f"rigel-{self.name}-{machine}", "nft", "-f", "-"]
            subprocess.run(words, input=text, text=True, check=True)

    def machines(self) -> list[str]:
        """Return the names of the machines."""
        return [node["metadata"]["name"] for node in self.cluster.list("v1", "Node")]


@contextmanager
def enforced(cluster: Any, name: str) -> Iterator[Enforcer]:
    """Enforce all policies of a local cluster; afterwards none."""
    enforcer = Enforcer(cluster, name)
    enforcer.step()
    thread = threading.Thread(target=enforcer.run)
    thread.start()
    try:
        yield enforcer
    finally:
        enforcer.ended.set()
        thread.join()
        enforcer.nft(f"delete table inet {TABLE}")
