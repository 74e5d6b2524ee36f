"""Mode `zenoh`: a router in the middle, for rmw_zenoh."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rigel_k8s.network.dds import EARLY
from rigel_k8s.network.mode import Mode, ModeUse, mode_path
from rigel_k8s.network.modes.servers import (
    SERVER_KEYS,
    command_line,
    container_port,
    environment,
    server_deployment,
    server_probes,
    server_service,
)
from rigel_k8s.network.options import ZENOH_PORT, Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Problem

ROUTER = ["ros2", "run", "rmw_zenoh_cpp", "rmw_zenohd"]
#: With its own default, [::], it ends on machines without IPv6.
LISTEN = f'listen/endpoints=["tcp/0.0.0.0:{ZENOH_PORT}"]'


def router_name(release: str) -> str:
    """Return the name of the router's Deployment and of its Service."""
    return object_name(f"{release}-zenoh")


class Zenoh(Mode):
    """A router in the middle."""

    name = "zenoh"
    keys = SERVER_KEYS
    middleware = "zenoh"
    own_domain = True
    looks_beyond = False
    remedy = "check that the router's pod runs, its Service exists, and TCP port 7447 is open"

    def objects(self, plan: NetworkPlan, network: Network) -> Iterator[Object]:
        """Yield the router and its Service."""
        name = router_name(plan.release)
        container = {
            "name": "zenoh-router",
            "args": command_line(network, ROUTER),
            "env": environment({"ZENOH_CONFIG_OVERRIDE": {"value": LISTEN}}),
            "ports": [container_port("zenoh", ZENOH_PORT, "TCP")],
            **server_probes({"tcpSocket": {"port": ZENOH_PORT}}),
        }
        yield server_service(plan, name, ZENOH_PORT, "TCP")
        yield server_deployment(plan, network, name, container)

    def wire(self, plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
        """Return the wiring that makes a pod a client of the router, which it waits for."""
        router = router_name(plan.release)
        override = f'mode="client";connect/endpoints=["tcp/{router}:{ZENOH_PORT}"]'
        return Wiring(
            env={
                "ZENOH_CONFIG_OVERRIDE": {"value": override},
                "ZENOH_ROUTER_CHECK_ATTEMPTS": {"value": "0"},
            },
            annotations=network_note(plan),
        )

    def check(self, network: Network, use: ModeUse) -> Iterator[Problem]:
        """Yield applications that do not support zenoh."""
        if use.ros.dds and not use.ros.rmw:
            message = f"{use.ros.title} does not support zenoh: use macvlan, peers or host"
            yield Problem(mode_path(network), message, "wrong-mode")
        elif use.middleware not in (None, "zenoh"):
            message = f"{use.middleware} does not work with a zenoh router: set `middleware: zenoh`"
            yield Problem(("middleware",), message, "wrong-mode")
        elif use.distro.lower() in EARLY - {"humble"}:
            yield Problem(mode_path(network), f"{use.distro} has no rmw_zenoh", "wrong-mode")

    def services(self, release: str, network: Network, workloads: Sequence[str]) -> list[str]:
        """Return the name of the router's Service."""
        return [router_name(release)]


ZENOH = Zenoh()
