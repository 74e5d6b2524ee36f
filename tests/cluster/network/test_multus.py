"""Multus and whereabouts on the shared cluster: nothing here takes them away."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from rigel_k8s.network.options import Install
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import DeployOptions
from rigel_multus.install import install
from rigel_multus.installation import RELEASE
from tests.support.until import until

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("multus")]

#: How often how many pods come and go.
WAVES, SIZE = 2, 9


def test_a_pod_on_every_node_gets_its_interface(lab: Any) -> None:
    """On each node a pod has net1, with an address that no other has, and they reach each other."""
    lab.attachment("10.213.1.0/24")
    pods = [lab.start(f"on-{node}", node=node) for node in lab.nodes]
    addresses = [lab.address_of(pod) for pod in pods]
    assert all(lab.has_interface(pod["metadata"]["name"]) for pod in pods)
    assert len({*addresses, ""}) == len(lab.nodes) + 1
    last = pods[-1]["metadata"]["name"]
    for address in addresses[:-1]:
        assert " 0% packet loss" in lab.inside(last, "ping", "-c3", "-W5", address)


def test_a_proof_leaves_nothing_behind(cluster: Any, said: Any) -> None:
    """A proof's pods, attachment and addresses are gone when it is over."""
    cluster.delete(ObjectRef("v1", "ConfigMap", RELEASE.namespace, "rigel-network-proof"))
    done = install(cluster, Install(), DeployOptions(report=said))
    assert [text for text in said.texts if "attaches pods" in text] != []
    assert len(done.nodes) == len(cluster.nodes())

    def left() -> list[str]:
        return [
            live["metadata"]["name"]
            for kind in (
                ("v1", "Pod"),
                ("k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition"),
                ("whereabouts.cni.cncf.io/v1alpha1", "IPPool"),
                ("whereabouts.cni.cncf.io/v1alpha1", "OverlappingRangeIPReservation"),
            )
            for live in cluster.list(*kind, RELEASE.namespace)
            if "proof" in live["metadata"]["name"] or live["metadata"]["name"].startswith("198.18.")
        ]

    # The network of a pod that has ended is taken down a moment after it; and a deploy of another
    # process may be proving as well.
    until(lambda: not left(), "end of what a proof needs", 120, last_words=left)


def test_whereabouts_gives_no_address_twice(lab: Any) -> None:
    """Many pods come and go over all nodes: at no time do two have one address.

    What is looked at is each pod's interface, not what anybody has written down. Each wave starts
    while the one before is still ending, and ends up with no address left over.
    """
    lab.attachment("10.213.0.0/16")
    held: set[str] = set()
    for wave in range(WAVES):
        names = [f"w{wave}-{number}" for number in range(SIZE)]
        lab.cluster.parallel(lab.cluster.create, [lab.pod(name) for name in names])
        pods = lab.cluster.parallel(lab.running, names)
        told = {pod["metadata"]["name"]: lab.address_of(pod) for pod in pods}
        real = dict(lab.cluster.parallel(lambda name: (name, real_address(lab, name)), names))
        assert real == told
        assert [a for a, count in Counter(real.values()).items() if count > 1 or not a] == []
        held |= set(real.values())
        for name in names:
            ref = ObjectRef("v1", "Pod", lab.namespace, name)
            lab.cluster.delete(ref, grace_seconds=0)
    lab.until(lambda: not lab.pods(), "end of all pods", 300)
    assert len(held) >= SIZE
    lab.until(lambda: not allocated(lab.cluster, "10.213.0.0-16"), "addresses given back", 300)


def real_address(lab: Any, name: str) -> str:
    """Return the address that a pod's interface has."""
    words = lab.inside(name, "/bin/sh", "-c", "ip -4 -o addr show dev net1").split()
    return str(words[3].partition("/")[0])


def allocated(cluster: Any, pool: str) -> dict[str, Any]:
    """Return the addresses of a pool that are given out."""
    ref = ObjectRef("whereabouts.cni.cncf.io/v1alpha1", "IPPool", RELEASE.namespace, pool)
    return dict((cluster.get(ref) or {}).get("spec", {}).get("allocations", {}))
