"""Mode `discovery-server`: Fast DDS' discovery servers.

Clients have a list of servers; a server's place in the list is its id.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rigel_k8s.network.dds import shares_memory, transports
from rigel_k8s.network.mode import Mode, ModeUse
from rigel_k8s.network.modes.servers import (
    SERVER_KEYS,
    command_line,
    container_port,
    environment,
    server_deployment,
    server_probes,
    server_service,
)
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Problem

DISCOVERY_PORT = 11811

#: Variables that a user's own command may contain too: a server's place in the list, and its name.
SERVER_ID, SERVER_NAME = "SERVER_ID", "SERVER_NAME"
#: A client always sends to the address that a server announces. So the server announces that of its
#: Service, which does not change; it listens on all its own addresses anyway.
SERVER = ["fastdds", "discovery", "-i", f"$({SERVER_ID})", "-l", f"$({SERVER_NAME})", "-p"]

#: Kubernetes cannot probe UDP from outside; the kernel lists what listens (11811 is 2E23).
LISTENS = (
    f"while read -r _ local _; do case $local in *:{DISCOVERY_PORT:04X}) exit 0 ;; esac;"
    " done </proc/net/udp; exit 1"
)


def server_names(release: str, network: Network) -> list[str]:
    """Return the names of the servers, each that of a Deployment and of its Service."""
    return [
        object_name(f"{release}-discovery-{index}") for index in range(int(network.servers or 1))
    ]


def addresses(plan: NetworkPlan, network: Network) -> list[str]:
    """Return the servers' addresses for clients, HOST:PORT."""
    return [f"{name}:{DISCOVERY_PORT}" for name in server_names(plan.release, network)]


class DiscoveryServer(Mode):
    """Servers in the middle, from which clients learn of each other."""

    name = "discovery-server"
    keys = SERVER_KEYS | {"servers"}
    middleware = "fastdds"
    own_domain = True
    asks_servers = True
    sets_transports = True
    domain_bound = "the servers' other clients are in"
    remedy = "check that the server's pod runs, its Service exists, and UDP passes both ways"

    def objects(self, plan: NetworkPlan, network: Network) -> Iterator[Object]:
        """Yield the servers and their Services."""
        names = server_names(plan.release, network)
        for index, name in enumerate(names):
            identity = {SERVER_ID: {"value": str(index)}, SERVER_NAME: {"value": name}}
            container = {
                "name": "discovery-server",
                "args": command_line(network, [*SERVER, str(DISCOVERY_PORT)]),
                "env": environment({**transports(plan), **identity}),
                "ports": [container_port("discovery", DISCOVERY_PORT, "UDP")],
                **server_probes({"exec": {"command": ["/bin/sh", "-c", LISTENS]}}),
            }
            yield server_service(plan, name, DISCOVERY_PORT, "UDP")
            yield server_deployment(plan, network, name, container, earlier=names[:index])

    def wire(self, plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
        """Return the wiring that makes a pod a client of the servers."""
        servers = ";".join(addresses(plan, network))
        return Wiring(
            env={"ROS_DISCOVERY_SERVER": {"value": servers}, **transports(plan, pod)},
            annotations=network_note(plan, shared_memory=shares_memory(plan, pod)),
        )

    def check(self, network: Network, use: ModeUse) -> Iterator[Problem]:
        """Yield a middleware that has no discovery servers."""
        if use.middleware not in (None, "fastdds"):
            message = "only Fast DDS has discovery servers: use peers, or middleware: fastdds"
            yield Problem(("middleware",), message, "wrong-mode")

    def services(self, release: str, network: Network, workloads: Sequence[str]) -> list[str]:
        """Return the names of the servers' Services."""
        return server_names(release, network)

    def join(self, plan: NetworkPlan, network: Network) -> dict[str, Any]:
        """Return the servers to ask."""
        return {"mode": "discovery-server", "servers": addresses(plan, network)}

    def join_seen(self, workloads: Iterable[str], servers: Sequence[str]) -> dict[str, Any]:
        """Return the servers that a pod asks."""
        return {"mode": "discovery-server", "servers": [*servers]}


DISCOVERY_SERVER = DiscoveryServer()
