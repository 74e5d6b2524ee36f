"""Each network mode with real programs, deployed by a Rigelfile: who hears whom, and who again.

The pod network of the local cluster carries no multicast between pods, as most do not.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from ipaddress import IPv4Address
from typing import Any

import pytest

pytestmark = pytest.mark.cluster

Deploy = Callable[..., Any]
TALKER = {"args": ["talker.py"]}
APART = {"placement": {"apart_from": ["talker_1"]}}
LISTENER = {"args": ["listener.py"], **APART}
NODES = {"talker_1": TALKER, "talker_2": TALKER, "listener": LISTENER}
BOTH = {"talker_1", "talker_2"}
#: Of programs on DDS or zenoh alone, of which no one can take over from another.
ALONE = {"update": {"strategy": "Recreate"}}


@pytest.fixture(scope="class")
def by_peers(deployed: Deploy) -> Any:
    return deployed(network={"mode": "peers"}, nodes=NODES)


class TestPeers:
    """Static peers: a Service with a cluster address for each node, no multicast anywhere."""

    def test_both_talkers_are_heard(self, by_peers: Any) -> None:
        """On the pod network alone, from another machine."""
        machines = by_peers.project.machines()
        assert machines["listener"] != machines["talker-1"]
        assert by_peers.project.net1() == {}
        by_peers.until_heard("listener", BOTH)

    def test_a_talker_on_another_machine_is_found_again(self, by_peers: Any) -> None:
        """With another address; the listener, which looked its name up long ago, is not started
        anew.
        """
        before, uid = by_peers.address("talker-1"), uid_of(by_peers, "listener")
        by_peers.move("talker-1")
        assert by_peers.address("talker-1") != before
        by_peers.until_heard("listener", BOTH)
        assert uid_of(by_peers, "listener") == uid

    def test_a_listener_on_another_machine_finds_all_again(self, by_peers: Any) -> None:
        """The talkers, which know it by its Service, need not start anew either."""
        talkers = [uid_of(by_peers, "talker-1"), uid_of(by_peers, "talker-2")]
        by_peers.move("listener")
        by_peers.until_heard("listener", BOTH)
        assert [uid_of(by_peers, "talker-1"), uid_of(by_peers, "talker-2")] == talkers


class TestPeersOfCyclone:
    """Static peers, read by Cyclone DDS from its own configuration."""

    def test_both_talkers_are_heard_and_found_again(self, deployed: Deploy) -> None:
        """A talker that was rescheduled too."""
        nodes = {
            "talker_1": {**ALONE, "args": ["cyclone.py", "talker"]},
            "talker_2": {**ALONE, "args": ["cyclone.py", "talker"]},
            "listener": {**LISTENER, **ALONE, "args": ["cyclone.py", "listener"]},
        }
        release = deployed(network={"mode": "peers"}, middleware="cyclonedds", nodes=nodes)
        release.until_heard("listener", BOTH)
        release.move("talker-1")
        release.until_heard("listener", BOTH)


@pytest.fixture(scope="class")
def by_servers(deployed: Deploy) -> Any:
    return deployed(network={"mode": "discovery-server", "servers": 2}, nodes=NODES)


class TestDiscoveryServer:
    """Fast DDS' discovery server, from the wheels, behind a Service."""

    def test_both_talkers_are_heard(self, by_servers: Any) -> None:
        """Through servers that run the image of the nodes."""
        assert {"talker-1", "talker-2", "listener"} < set(by_servers.project.pods())
        by_servers.until_heard("listener", BOTH)

    def test_the_servers_are_on_two_machines(self, by_servers: Any) -> None:
        """The loss of one machine leaves one of them."""
        machines = by_servers.project.machines()
        servers = [where for name, where in machines.items() if "-discovery-" in name]
        assert len(set(servers)) == len(servers) == 2

    def test_introspection_sees_everybody(self, by_servers: Any) -> None:
        """`rigel exec` makes tools super clients, which servers tell everything."""
        words = ["exec", "listener", "--", "ros2", "node", "list", "--spin-time", "5"]
        everybody = {"/talker_1", "/talker_2", "/listener"}
        project = by_servers.project
        project.until(lambda: set(project(*words).stdout.split()) == everybody, "list of all nodes")

    def test_rescheduled_servers_are_found_again(self, by_servers: Any) -> None:
        """Both of them moved: who starts afterwards is heard, so clients have found them."""
        for server in sorted(set(by_servers.project.pods()) - {"talker-1", "talker-2", "listener"}):
            by_servers.move(server)
        uid = uid_of(by_servers, "listener")
        by_servers.move("talker-1")
        by_servers.until_heard("listener", BOTH, seconds=240)
        assert uid_of(by_servers, "listener") == uid


class TestHost:
    """The machine's own network."""

    def test_two_nodes_of_one_machine_exchange_data(self, deployed: Deploy, cluster: Any) -> None:
        """Each container has its own /dev/shm: without shared memory they do hear each other."""
        machine = cluster.list("v1", "Node")[0]["metadata"]["name"]
        there = {"placement": {"node": machine}}
        nodes = {"talker_1": {**TALKER, **there}, "listener": {**LISTENER, **there}}
        release = deployed(network={"mode": "host", "domain_id": 17}, nodes=nodes)
        machines = release.project.machines()
        assert machines["listener"] == machines["talker-1"]
        release.until_heard("listener", {"talker_1"})

    def test_nodes_of_two_machines_do_too(self, deployed: Deploy) -> None:
        """The machines share an Ethernet segment, which carries multicast."""
        release = deployed(network={"mode": "host", "domain_id": 18}, nodes=NODES)
        machines = release.project.machines()
        assert machines["listener"] != machines["talker-1"]
        release.until_heard("listener", BOTH)


@pytest.fixture(scope="class")
def by_router(deployed: Deploy, interop_image: str) -> Any:
    router = {"image": interop_image, "command": ["zenoh_node.py", "router"]}
    nodes = {
        "talker_1": {**ALONE, "args": ["zenoh_node.py", "talker"]},
        "talker_2": {**ALONE, "args": ["zenoh_node.py", "talker"]},
        "listener": {**LISTENER, **ALONE, "args": ["zenoh_node.py", "listener"]},
    }
    return deployed(network={"mode": "zenoh", **router}, nodes=nodes)


class TestZenoh:
    """A router and sessions by eclipse-zenoh, which read what rmw_zenoh reads.

    rmw_zenoh itself cannot be had here; see docs/what-was-run.md.
    """

    def test_both_talkers_are_heard_through_the_router(self, by_router: Any) -> None:
        """Sessions are clients of it, and know nobody else."""
        by_router.until_heard("listener", BOTH)

    def test_a_rescheduled_router_is_found_again(self, by_router: Any) -> None:
        """By the same sessions: none is started anew."""
        [router] = set(by_router.project.pods()) - {"talker-1", "talker-2", "listener"}
        uids = {name: uid_of(by_router, name) for name in ("talker-1", "talker-2", "listener")}
        by_router.move(router)
        by_router.until_heard("listener", BOTH)
        assert {name: uid_of(by_router, name) for name in uids} == uids


class TestHostNetwork:
    """Nodes on their machines' own network, in a release of another mode."""

    @pytest.mark.parametrize(
        "mode",
        [
            "peers",
            pytest.param("discovery-server", marks=pytest.mark.slow),
            pytest.param("zenoh", marks=pytest.mark.slow),
        ],
    )
    def test_they_and_the_others_hear_each_other(
        self, mode: str, deployed: Deploy, interop_image: str
    ) -> None:
        """In both directions, from machine to machine; `rigel status` finds nothing wrong."""
        words, network, more = ["{}.py"], dict[str, Any](mode=mode), dict[str, Any]()
        if mode == "zenoh":
            more = ALONE
            words = ["zenoh_node.py", "{}"]
            network |= {"image": interop_image, "command": ["zenoh_node.py", "router"]}
        talker = {"args": [word.format("talker") for word in words], **more}
        listener = {"args": [word.format("listener") for word in words], **APART, **more}
        nodes = {
            "talker_1": {**talker, "host_network": True},
            "talker_2": talker,
            "listener": listener,
            "listener_2": {**listener, "host_network": True},
        }
        release = deployed(network=network, nodes=nodes)
        machines, pods = release.project.machines(), release.project.pods()
        assert machines["talker-1"] not in (machines["listener"], machines["listener-2"])
        on_machine = {n for n, pod in pods.items() if pod["spec"].get("hostNetwork")}
        assert on_machine == {"talker-1", "listener-2"}
        release.until_heard("listener", BOTH)
        release.until_heard("listener_2", BOTH)

        def is_well() -> bool:
            done = release.project("status", "-o", "json", check=False)
            return done.returncode == 0 and json.loads(done.stdout)["graph"]["problems"] == []

        release.project.until(is_well, "status without problems")


class TestMacvlan:
    """A second network with static addresses."""

    def test_a_rescheduled_talker_is_heard_from_its_old_address(
        self, deployed: Deploy, multus: None
    ) -> None:
        """On another machine: the address is the node's for life."""
        lan = {"mode": "macvlan", "interface": "eth0", "subnet": "192.168.145.0/24"}
        release = deployed(network={**lan, "ipam": "static"}, nodes=NODES)
        release.until_heard("listener", BOTH)
        before = release.project.net1()
        release.move("talker-1")
        release.until_heard("listener", BOTH)
        assert release.project.net1() == before

    def test_whereabouts_gives_addresses_that_dds_is_pinned_to(
        self, deployed: Deploy, multus: None
    ) -> None:
        """Nobody knows them beforehand: they are found out in the pod. Routes and MTU are there."""
        lan = {"mode": "macvlan", "interface": "eth0", "subnet": "192.168.146.0/24"}
        way = {"gateway": "192.168.146.254", "routes": ["10.251.0.0/16"], "mtu": 1300}
        release = deployed(network={**lan, **way, "ipam": "whereabouts"}, nodes=NODES)
        release.until_heard("listener", BOTH)
        assert len(set(release.project.net1().values())) == 3
        shown = ["cat", "/sys/class/net/net1/mtu", "/proc/net/route"]
        told = release.project("exec", "listener", "--", *shown).stdout
        assert told.splitlines()[0] == "1300"
        assert "net1\t0000FB0A\tFE92A8C0\t" in told  # 10.251.0.0 through 192.168.146.254

    def test_host_local_is_enough_for_one_machine(
        self, deployed: Deploy, cluster: Any, multus: None
    ) -> None:
        """Its pods have addresses of their own and hear each other; the machine counts them."""
        machine = cluster.list("v1", "Node")[0]["metadata"]["name"]
        there = {**TALKER, "placement": {"node": machine}}
        nodes = {"talker_1": there, "listener": {**there, "args": ["listener.py"]}}
        lan = {"mode": "macvlan", "interface": "eth0", "ipam": "host-local"}
        release = deployed(network=lan, nodes=nodes)
        release.until_heard("listener", {"talker_1"})
        found = release.project.net1()
        assert len({IPv4Address(one) for one in found.values()} & {*release.project.subnet}) == 2

    def test_an_attachment_that_is_there(
        self, deployed: Deploy, cluster: Any, namespace: str, multus: None
    ) -> None:
        """Of another namespace, with addresses of its own."""
        config = {
            "cniVersion": "0.3.1",
            "type": "macvlan",
            "master": "eth0",
            "ipam": {"type": "whereabouts", "range": "10.196.0.0/24"},
        }
        there = {
            "apiVersion": "k8s.cni.cncf.io/v1",
            "kind": "NetworkAttachmentDefinition",
            "metadata": {"name": "garage", "namespace": namespace},
            "spec": {"config": json.dumps(config)},
        }
        cluster.create(there)
        network = {"mode": "attachment", "attachment": f"{namespace}/garage", "domain_id": 19}
        release = deployed(network=network, nodes=NODES)
        release.until_heard("listener", BOTH)
        assert {one.rpartition(".")[0] for one in release.project.net1().values()} == {"10.196.0"}
        release.project("down")


class TestPlainDds:
    """An application that knows nothing of ROS: its own topic, its own type, no ROS variables."""

    @pytest.mark.parametrize(
        "network",
        [
            {
                "mode": "macvlan",
                "interface": "eth0",
                "subnet": "192.168.147.0/24",
                "ipam": "static",
            },
            {"mode": "peers"},
        ],
        ids=["macvlan", "peers"],
    )
    def test_talker_and_listener_meet(
        self, deployed: Deploy, multus: None, network: dict[str, str]
    ) -> None:
        """With the same key as ROS 2, and nothing of ROS in their environment."""
        named = {"env": {"NODE_NAME": "talker_1"}}
        nodes = {
            "talker_1": {"args": ["cyclone.py", "plain-talker"], **named},
            "listener": {**LISTENER, "args": ["cyclone.py", "plain-listener"]},
        }
        release = deployed(ros="none", network=network, nodes=nodes)
        release.until_heard("listener", {"talker_1"})
        container = release.project.pods()["listener"]["spec"]["containers"][0]
        assert [one["name"] for one in container["env"] if one["name"].startswith("R")] == []
        assert container["args"] == ["cyclone.py", "plain-listener"]


LAN = {"mode": "macvlan", "interface": "eth0", "subnet": "192.168.148.0/24", "ipam": "static"}


@pytest.mark.slow
class TestKilted:
    """Fast DDS 3, which wants other variables, and takes pods of one machine-id for one machine."""

    @pytest.mark.parametrize(
        "network",
        [LAN, {"mode": "peers"}, {"mode": "discovery-server"}],
        ids=lambda one: one["mode"],
    )
    def test_both_talkers_are_heard(
        self, deployed: Deploy, kilted_image: str, multus: None, network: dict[str, str]
    ) -> None:
        """In the modes whose configuration depends on the version."""
        release = deployed(distro="kilted", network=network, nodes=NODES)
        release.until_heard("listener", BOTH)


def uid_of(release: Any, workload: str) -> str:
    """Return what tells a pod from the next one of its workload, and its container's restarts."""
    pod = release.project.pods()[workload]
    restarts = sum(one["restartCount"] for one in pod["status"]["containerStatuses"])
    return f"{pod['metadata']['uid']} {restarts}"
