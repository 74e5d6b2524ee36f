"""Mode `peers`: no multicast; each pod has a list of all pods, by their Services.

A program resolves names only when it starts, so their addresses must not change: each workload has
a Service with a cluster address, which also leads to a pod that was started again elsewhere. Only
the first message goes to the Service; the answer comes from the pod's own address, and so does all
that follows. It is enough if one of two pods has the other in its list: a new pod lists all others,
so they need not restart.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import attrs

from rigel_k8s.network.dds import (
    CYCLONE_FILE,
    PARTICIPANTS,
    cyclone_config,
    cyclone_variables,
    fastdds_profiles,
    fastdds_variables,
    reads_transports,
    shares_memory,
    transports,
    uses,
)
from rigel_k8s.network.files import config_name, files_config, make_context, mount_files
from rigel_k8s.network.mode import Mode, ModeUse
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.naming import object_name, selector
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Problem

PEERS_KEY = "peers"
#: The program's own pod, for tools that a user runs in it.
LOOPBACK = "127.0.0.1"
HOSTNAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?")
ONE_SERVICE = (
    "with `peers` a Service leads to one pod, so the other replicas would not be discovered;"
    " make each a node of its own, or use discovery-server"
)


def peer_name(workload: str) -> str:
    """Return the name of a workload's Service; the workload's own name is taken by its ports."""
    return object_name(f"{workload}-peer")


def discovery_port(domain: int, participant: int) -> int:
    """Return the UDP port on which a participant receives announcements (DDSI-RTPS 9.6.1.1)."""
    return 7400 + 250 * domain + 10 + 2 * participant


def peer_service(plan: NetworkPlan, pod: PodIdentity) -> Object:
    """Return a workload's Service.

    It leads to ready pods only: a pod on a lost machine still exists when another one has replaced
    it, and would get half of what others send. A pod that is not ready yet is discovered as well,
    since it announces itself to the ready ones.
    """
    ports = [
        {"name": f"participant-{index}", "port": port, "targetPort": port, "protocol": "UDP"}
        for index in range(PARTICIPANTS)
        for port in [discovery_port(plan.domain_id or 0, index)]
    ]
    return {
        "apiVersion": "v1",
        "kind": "Service",
        "metadata": make_context(plan).metadata(peer_name(pod.name), part_of=pod.name),
        "spec": {
            "selector": selector(pod.name),
            "ipFamilies": ["IPv4"],
            "ports": ports,
        },
    }


def peer_files(plan: NetworkPlan, network: Network) -> dict[str, str]:
    """Return the list, in the form of each middleware that may read it."""
    names = [*(peer_name(pod.name) for pod in plan.pods), *network.peers]
    found: dict[str, str] = {}
    if uses(plan, "fastdds"):
        if reads_transports(plan):
            found[PEERS_KEY] = ";".join(names)
        else:
            found |= fastdds_profiles(plan, peers=[LOOPBACK, *names])
    if uses(plan, "cyclonedds"):
        ports = [discovery_port(plan.domain_id or 0, index) for index in range(PARTICIPANTS)]
        listed = [f"{name}:{port}" for name in [LOOPBACK, *names] for port in ports]
        found[CYCLONE_FILE] = cyclone_config(peers=listed, multicast=False)
    return found


def variables(plan: NetworkPlan, pod: PodIdentity) -> dict[str, Object]:
    """Return the variables by which each middleware finds the list."""
    found: dict[str, Object] = {}
    if uses(plan, "fastdds"):
        of_ros = reads_transports(plan)
        found |= peers_variables(plan, pod) if of_ros else fastdds_variables(plan, pod)
    if uses(plan, "cyclonedds"):
        found |= cyclone_variables()
    return found


def peers_variables(plan: NetworkPlan, pod: PodIdentity) -> dict[str, Object]:
    """Return ROS 2's own variables, from jazzy on."""
    reference = {"configMapKeyRef": {"name": config_name(plan), "key": PEERS_KEY}}
    return {
        "ROS_STATIC_PEERS": {"valueFrom": reference},
        **transports(plan, pod),
    }


class Peers(Mode):
    """A list of all pods in each pod."""

    name = "peers"
    keys = frozenset({"peers"})
    own_domain = True
    lists_peers = True
    sets_transports = True
    domain_bound = "the Services of `peers` open only the ports of"
    one_pod = ONE_SERVICE
    participants = PARTICIPANTS
    remedy = (
        "check that each workload's Service exists, and no NetworkPolicy or firewall blocks UDP"
    )

    def objects(self, plan: NetworkPlan, network: Network) -> Iterator[Object]:
        """Yield the Services, and the list of all of them."""
        for pod in plan.pods:
            yield peer_service(plan, pod)
        yield files_config(plan, peer_files(plan, network))

    def wire(self, plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
        """Return the wiring that lets a pod look for the others."""
        reads_files = uses(plan, "cyclonedds") or not reads_transports(plan)
        base = mount_files(plan) if reads_files else Wiring()
        # A pod reads the list of peers when it starts, so it must start again when `peers` changes.
        text = json.dumps(sorted(network.peers))
        mark = hashlib.sha256(text.encode()).hexdigest()[:8] if network.peers else None
        note = network_note(plan, config=mark, shared_memory=shares_memory(plan, pod))
        return attrs.evolve(base, env=variables(plan, pod), annotations=note)

    def check(self, network: Network, use: ModeUse) -> Iterator[Problem]:
        """Yield peers that are neither a name nor an IPv4 address."""
        for index, peer in enumerate(network.peers):
            if not HOSTNAME.fullmatch(peer):
                message = f'"{peer}" is neither a name nor an IPv4 address (without a port)'
                yield Problem(("network", "peers", index), message, "bad-peer")

    def services(self, release: str, network: Network, workloads: Sequence[str]) -> list[str]:
        return [peer_name(workload) for workload in workloads]

    def join(self, plan: NetworkPlan, network: Network) -> dict[str, Any]:
        """Return the names of all participants to look for."""
        names = [*(peer_name(pod.name) for pod in plan.pods), *network.peers]
        return {"mode": "peers", "peers": names}

    def join_seen(self, workloads: Iterable[str], servers: Sequence[str]) -> dict[str, Any]:
        """Return the names of the Services."""
        return {"mode": "peers", "peers": sorted(set(map(peer_name, workloads)))}


PEERS = Peers()
