"""The example of ROS 1 with another network."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.cluster

Make = Callable[..., Any]


LAN = {"mode": "macvlan", "interface": "eth0", "ipam": "static"}


def test_ros_1_over_a_second_network(project: Make, base_image: str, multus: None) -> None:
    """The master too is on net1: its nodes tell each other addresses of net1, nothing else."""
    ros1 = project(
        "ros1-talker-listener",
        base_image,
        lambda options: options.update(network=dict(LAN)),
    )
    ros1("run", "sequence", "demo")
    net1 = ros1.net1()
    assert set(net1) == {"ros-master", "talker", "listener"}
    assert told_hosts(ros1) == {net1["talker"], net1["listener"]}
    master = ros1("exec", "talker", "--", "printenv", "ROS_MASTER_URI").stdout
    assert net1["ros-master"] in master


def test_ros_1_over_the_machines_own_network(project: Make, base_image: str) -> None:
    """Nodes tell each other the machines' addresses."""
    ros1 = project(
        "ros1-talker-listener", base_image, lambda options: options.update(network={"mode": "host"})
    )
    ros1("run", "sequence", "demo")
    pods = ros1.pods()
    expected = {pods[name]["status"]["hostIP"] for name in ("talker", "listener")}
    assert len(expected) == 2
    assert told_hosts(ros1) == expected


def told_hosts(ros1: Any) -> set[str]:
    """Return the hosts that ROS 1's nodes of /chatter have told each other."""
    told = ros1("exec", "talker", "--", "rostopic", "info", "/chatter").stdout
    return set(re.findall(r"http://([\d.]+):", told))
