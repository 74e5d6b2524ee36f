"""The examples with another network, or none; with many nodes; with a machine that leaves."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rigel_lab.cluster.network import link_name

from ..machines import lose
from .conftest import projects

pytestmark = pytest.mark.cluster

TALKERS = {"talker_1", "talker_2"}
Make = Callable[..., Any]


LAN = {"mode": "macvlan", "interface": "eth0", "ipam": "static"}


@pytest.fixture
def project(cluster: Any, context: str, registry: str, tmp_path: Path) -> Iterator[Make]:
    """Make projects for one test: twenty nodes are too many to run beside the next."""
    with projects(cluster, context, registry, tmp_path) as make:
        yield make


def test_without_a_network_it_is_deaf_and_that_is_told(project: Make, ros2_image: str) -> None:
    """The same Rigelfile less one key: all pods are Ready, none is heard; rigel says so."""
    plain = project("ros2-talker-listener", ros2_image, lambda options: options.pop("network"))
    done = plain("run", "sequence", "demo")
    told = " ".join((done.stdout + done.stderr).split())
    assert "nodes on different machines will not find each other" in told  # before the deploy
    assert (
        "pods on different machines do not discover each other; a pod network" in told
    )  # after it
    assert "set `network` to macvlan" in told
    assert len(set(plain.machines().values())) == 3
    assert plain.heard() == []
    assert "do not discover each other" in plain("status").stdout


@pytest.mark.slow
def test_twenty_nodes_on_three_machines_hear_each_other(
    project: Make, ros2_image: str, multus: None
) -> None:
    """Each of 19 talkers is heard, and a talker knows all twenty."""
    talkers = {f"talker_{n:02}" for n in range(19)}

    def change(options: dict[str, Any]) -> None:
        nodes = options["nodes"]
        one = {**nodes["talker_1"], "parameters": {"rate": 1.0}}
        del one["args"]
        one.update(package="talker_listener", executable="talker.py")  # by ros2 run
        listener = {**nodes["listener"], "placement": {}}
        options["nodes"] = {**dict.fromkeys(sorted(talkers), one), "listener": listener}
        options["network"] = dict(LAN)

    many = project("ros2-talker-listener", ros2_image, change)
    for job in ("build-talker", "build-listener", "deploy"):
        many("run", "job", job)
    assert len(set(many.machines().values())) == 3
    many.until(lambda: many.talkers(since=5) == talkers, "message of every talker")
    words = ["exec", "talker_07", "--", "ros2", "node", "list", "--spin-time", "6"]
    everybody = {f"/{name}" for name in talkers | {"listener"}}
    many.until(lambda: set(many(*words).stdout.split()) == everybody, "list of all twenty")


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


@pytest.fixture(scope="module")
def own_demo(own_cluster: Make) -> Any:
    """The example with fixed addresses, on a cluster that may be broken."""
    demo = own_cluster("ros2-talker-listener", change=lambda o: o["network"].update(ipam="static"))
    demo("run", "sequence", "demo")
    return demo


@pytest.mark.slow
def test_machines_that_are_cut_off_from_each_other_are_named(own_demo: Any) -> None:
    """Multicast is dropped on the wire between them; they forget each other when a lease ends."""
    machines = own_demo.machines()
    pair = sorted([machines["talker-1"], machines["listener"]])

    def deaf() -> Any:
        return json.loads(own_demo("status", "-o", "json", check=False).stdout)["graph"]["deaf"]

    with dropped(own_demo.context.removeprefix("rigel-"), *pair):
        own_demo.until(lambda: deaf() == [{"from": pair[0], "to": pair[1]}], "pair that is cut off")
        told = own_demo("status", check=False)
    text = f"the pods on {pair[0]} and {pair[1]} do not discover each other;"
    assert text in " ".join(told.stdout.split())
    assert told.returncode == 1
    own_demo.until(lambda: deaf() == [], "pair that has found each other again")


@contextmanager
def dropped(cluster: str, one: str, other: str) -> Iterator[None]:
    """Have the wire drop everything over UDP between two machines' second networks."""
    first, second = link_name(cluster, one), link_name(cluster, other)
    rules = f"""
    table bridge t-drop {{
        chain drops {{
            type filter hook forward priority 0;
            iifname {first} oifname {second} udp dport 7400-7800 drop
            iifname {second} oifname {first} udp dport 7400-7800 drop
        }}
    }}
    """
    subprocess.run(["nft", "-f", "-"], input=rules, text=True, check=True)
    try:
        yield
    finally:
        subprocess.run(["nft", "delete", "table", "bridge", "t-drop"], check=True)


@pytest.mark.slow
def test_a_machine_that_leaves_takes_only_its_own_node_along(own_demo: Any) -> None:
    """The other talker is heard on; the machine back, its talker is too, with its old address."""
    demo = own_demo
    addresses, machine = demo.net1(), demo.machines()["talker-2"]
    lose(demo.context.removeprefix("rigel-"), machine)
    demo.until(lambda: demo.talkers() == {"talker_1"}, "end of talker_2 alone")
    number = demo.heard()[-1][1]
    demo.until(lambda: demo.heard()[-1][1] > number + 20, "further messages of talker_1")
    told = demo("status").stdout
    assert re.search(r"^talker-2-\S+ could not be checked", told, re.MULTILINE)
    assert re.search(r"talker-1 .* 1/1 ", told)  # the two others still know each other
    demo.rigel("cluster", "up", "--name", demo.context.removeprefix("rigel-"))
    demo.until(lambda: demo.talkers() == TALKERS, "messages of both", seconds=300)
    assert demo.net1() == addresses
