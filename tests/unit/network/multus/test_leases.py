"""Which pods have an address by DHCP that nobody renews any more."""

from __future__ import annotations

import json
from typing import Any

from rigel_k8s.network.multus.leases import find_unkept

EARLY, LATE, LATEST = "2026-01-01T10:00:00Z", "2026-01-01T10:00:05Z", "2026-01-01T11:00:00Z"


def pod(name: str, *, node: str = "node1", started: str = EARLY, **changes: Any) -> dict[str, Any]:
    """A pod with an init container that asks for `lan`."""
    ended = {"terminated": {"startedAt": started}}
    restarted = {"running": {"startedAt": LATEST}}
    return {
        "metadata": {
            "name": name,
            "namespace": "robots",
            "annotations": {"k8s.v1.cni.cncf.io/networks": changes.get("networks", "lan")},
        },
        "spec": {"nodeName": node},
        "status": {
            "phase": changes.get("phase", "Running"),
            "initContainerStatuses": [{"name": "rigel-network", "state": ended}],
            "containerStatuses": [{"name": "ros-node", "state": restarted}],
        },
    }


def daemon(node: str, started: str | None) -> dict[str, Any]:
    """Multus' pod of a node, with or without the DHCP daemon."""
    statuses = [{"name": "multus", "state": {"running": {"startedAt": LATEST}}}]
    if started:
        statuses.append({"name": "dhcp", "state": {"running": {"startedAt": started}}})
    return {"spec": {"nodeName": node}, "status": {"containerStatuses": statuses}}


def attachment(ipam: str, name: str = "lan") -> dict[str, Any]:
    """A NetworkAttachmentDefinition of the namespace."""
    config = json.dumps({"type": "macvlan", "ipam": {"type": ipam}})
    return {"metadata": {"name": name, "namespace": "robots"}, "spec": {"config": config}}


LAN = [attachment("dhcp"), attachment("whereabouts", "other")]


def test_a_pod_older_than_its_daemon_is_named() -> None:
    """What counts is when the pod was attached, not when its program was last started."""
    pods = [pod("old"), pod("new", started=LATEST), pod("there", node="node2")]
    (one,) = find_unkept(pods, [daemon("node1", LATE), daemon("node2", EARLY)], LAN)
    assert str(one) == (
        "the DHCP lease of pod robots/old on node1 at robots/lan is no longer renewed: the"
        " DHCP daemon there started after the pod"
    )


def test_what_has_nothing_to_do_with_it_is_not_named() -> None:
    """Pods of other networks, ended ones, and those of machines with a daemon of their own."""
    pods = [pod("other", networks="other"), pod("ended", phase="Succeeded")]
    assert find_unkept(pods, [daemon("node1", LATE)], LAN) == []
    assert find_unkept([pod("old")], [daemon("node1", None)], LAN) == []
    assert find_unkept([pod("old")], [daemon("node1", LATE)], [attachment("static")]) == []
    listed = {"metadata": LAN[0]["metadata"], "spec": {"config": "no JSON"}}
    assert find_unkept([pod("old")], [daemon("node1", LATE)], [listed]) == []
