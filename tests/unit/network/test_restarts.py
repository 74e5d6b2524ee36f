"""A changed pod template restarts a robot: who restarts when the network or a neighbour changes."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from ..app.shapes import find, release

MACVLAN = {"mode": "macvlan", "interface": "eth0", "subnet": "10.20.0.0/24"}
NETWORKS: list[Any] = [
    MACVLAN,
    {**MACVLAN, "ipam": "static"},
    {"mode": "attachment", "attachment": "lan"},
    "peers",
    {"mode": "discovery-server", "servers": 2},
    "zenoh",
    "host",
]


def template(
    network: Any, names: tuple[str, ...] = ("talker",), distro: str = "jazzy", **more: Any
) -> Any:
    """Return the talker's pod template on a network, beside other nodes."""
    nodes = {name: {"image": "a", "args": ["run"]} for name in names}
    made = release(yaml.safe_dump({"nodes": nodes, "network": network}), distro=distro, **more)
    return find(made, "Deployment", "talker")["spec"]["template"]


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
@pytest.mark.parametrize("network", NETWORKS, ids=str)
def test_nobody_restarts_because_a_neighbour_comes(network: Any, distro: str) -> None:
    """Before and behind in the alphabet; with static addresses the last revision is asked."""
    alone = template(network, distro=distro)
    text = yaml.safe_dump(
        {"nodes": {"talker": {"image": "a", "args": ["run"]}}, "network": network}
    )
    previous = release(text, distro=distro).objects
    names = ("ape", "talker", "zebra")
    assert template(network, names, distro, previous=previous) == alone


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (MACVLAN, {**MACVLAN, "subnet": "10.21.0.0/24"}),
        (MACVLAN, {**MACVLAN, "interface": "eth1"}),
        (MACVLAN, {**MACVLAN, "mtu": 1400}),
        (MACVLAN, {**MACVLAN, "domain_id": 3}),
        ({"mode": "peers"}, {"mode": "peers", "peers": ["robot"]}),
        ({"mode": "peers"}, {"mode": "peers", "domain_id": 3}),
        ({"mode": "discovery-server"}, {"mode": "discovery-server", "servers": 2}),
    ],
    ids=str,
)
def test_a_pod_restarts_when_its_own_network_changes(before: Any, after: Any) -> None:
    """A pod keeps the interface and the variables that it got, so another pod must get others."""
    assert template(before) != template(after)
