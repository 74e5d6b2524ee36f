"""Which ROS processes find each other with `peers` if pods run more than four of them."""

from __future__ import annotations

import subprocess
import time

import pytest

from rigel_k8s.network.dds import PARTICIPANTS, fastdds_profile
from rigel_k8s.network.modes.peers import peer_name
from tests.support.until import until

pytestmark = pytest.mark.cluster

PODS, PROCESSES = ("one", "two"), PARTICIPANTS + 2
#: Prints the names of the nodes that it has found, again and again.
NODE = """
import rclpy, sys
rclpy.init()
node = rclpy.create_node(sys.argv[1])
while True:
    print(*sorted(node.get_node_names()), flush=True)
    rclpy.spin_once(node, timeout_sec=0.2)
"""
#: Longer than Fast DDS waits from one announcement to the next.
ANNOUNCED = 4.0


@pytest.mark.parametrize("early", [False, True], ids=["jazzy", "before-jazzy"])
def test_one_of_two_processes_is_among_the_first_four_of_its_pod(lab, tmp_path, early):
    """Or both are in one pod, from jazzy on; no others find each other (docs/network-modes.md)."""
    env = {"ROS_DOMAIN_ID": "0"}
    names = [peer_name(pod) for pod in PODS]
    if early:
        profile = tmp_path / "fastdds.xml"
        profile.write_text(fastdds_profile(peers=["127.0.0.1", *names]))
        env |= {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}
        env |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}  # older ones have no such range
    else:
        env |= {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_STATIC_PEERS": ";".join(names)}
    pods = [lab.start(name, name, "sleep", "600", **env) for name in PODS]
    lab.settle()
    lab.deaf(*PODS)
    lab.deaf(*reversed(PODS))
    nodes = [(pod.name, index) for pod in pods for index in range(PROCESSES)]
    logs = {node: tmp_path / f"{node[0]}{node[1]}.log" for node in nodes}

    def found(node):
        lines = logs[node].read_text().split("\n")
        return set(lines[-2].split()) if len(lines) > 1 else set()

    def expected(node):
        pod, index = node
        return {
            f"{other}{number}"
            for other, number in nodes
            if min(index, number) < PARTICIPANTS
            or (other == pod and (number == index or not early))
        }

    python = str(lab.venv("jazzy") / "bin" / "python")
    for pod in pods:
        for index in range(PROCESSES):  # one after another, so that each has its place
            node = pod.name, index
            line = pod.entering([python, "-c", NODE, f"{pod.name}{index}"])
            with logs[node].open("w") as file:
                process = subprocess.Popen(line, stdout=file, stderr=file)
            lab.cleanup.callback(process.wait)
            lab.cleanup.callback(process.kill)
            until(lambda node=node: found(node), f"{node} has started", 120)
    until(lambda: all(found(n) >= expected(n) for n in nodes), "all have found the others", 120)
    time.sleep(ANNOUNCED)
    assert {node: found(node) for node in nodes} == {node: expected(node) for node in nodes}
