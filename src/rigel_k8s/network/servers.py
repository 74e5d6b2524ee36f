"""Modes with somebody in the middle: Fast DDS' discovery servers, and zenoh's router.

Each server is a Deployment of one pod behind a Service with a cluster address, so that clients find
it again wherever it starts: they know it by its place in their list, which is its id.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rigel_k8s.network.dds import udp_only
from rigel_k8s.network.files import around
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.marks import FIRST_ANNOTATION
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.pods import Object, compact, inpod_volume, stop_hook
from rigel_k8s.objects.text import words
from rigel_k8s.objects.workloads import deployment, service

__all__ = [
    "DISCOVERY_PORT",
    "ZENOH_PORT",
    "discovery_objects",
    "discovery_wiring",
    "server_names",
    "zenoh_objects",
    "zenoh_wiring",
]

DISCOVERY_PORT = 11811
ZENOH_PORT = 7447

#: Variables that commands of the user's own may name too: a server's place in the list, its name.
SERVER_ID, SERVER_NAME = "SERVER_ID", "SERVER_NAME"
#: A client sends to the address that a server tells of itself, for ever. So it tells its Service's,
#: which stays; it listens on all of its own whatever it tells.
SERVER = ["fastdds", "discovery", "-i", f"$({SERVER_ID})", "-l", f"$({SERVER_NAME})", "-p"]
ROUTER = ["ros2", "run", "rmw_zenoh_cpp", "rmw_zenohd"]
#: Its own default, [::], ends it on machines without IPv6.
LISTEN = f'listen/endpoints=["tcp/0.0.0.0:{ZENOH_PORT}"]'

#: Kubernetes cannot probe UDP from outside; the kernel knows who listens (11811 is 2E23).
LISTENS = (
    f"while read -r _ local _; do case $local in *:{DISCOVERY_PORT:04X}) exit 0 ;; esac;"
    " done </proc/net/udp; exit 1"
)


def server_names(release: str, network: Network) -> list[str]:
    """Return the names of the mode's servers, each that of a Deployment and of its Service."""
    if network.mode == "zenoh":
        return [object_name(f"{release}-zenoh")]
    count = int(network.servers or 1)
    return [object_name(f"{release}-discovery-{index}") for index in range(count)]


def discovery_objects(plan: NetworkPlan, network: Network) -> Iterator[Object]:
    """Yield the discovery servers and their Services."""
    for index, name in enumerate(server_names(plan.release, network)):
        container = {
            "name": "discovery-server",
            "args": command_line(network, [*SERVER, str(DISCOVERY_PORT)]),
            "env": variables({**udp_only(plan), **told(index, name)}),
            "ports": [port("discovery", DISCOVERY_PORT, "UDP")],
            **probes({"exec": {"command": ["/bin/sh", "-c", LISTENS]}}),
        }
        yield server_service(plan, name, DISCOVERY_PORT, "UDP")
        yield server_deployment(plan, network, name, container)


def zenoh_objects(plan: NetworkPlan, network: Network) -> Iterator[Object]:
    """Yield the router and its Service."""
    [name] = server_names(plan.release, network)
    container = {
        "name": "zenoh-router",
        "args": command_line(network, ROUTER),
        "env": variables({"ZENOH_CONFIG_OVERRIDE": {"value": LISTEN}}),
        "ports": [port("zenoh", ZENOH_PORT, "TCP")],
        **probes({"tcpSocket": {"port": ZENOH_PORT}}),
    }
    yield server_service(plan, name, ZENOH_PORT, "TCP")
    yield server_deployment(plan, network, name, container)


def command_line(network: Network, default: Sequence[str]) -> list[str]:
    """Return what the image's ENTRYPOINT runs."""
    return words(network.command) if network.command else list(default)


def told(index: int, name: str) -> dict[str, Object]:
    """Return what tells a server which one it is."""
    return {SERVER_ID: {"value": str(index)}, SERVER_NAME: {"value": name}}


def variables(sources: dict[str, Object]) -> list[Object]:
    """Return a container's environment."""
    return [{"name": name, **source} for name, source in sources.items()]


def probes(check: Object) -> Object:
    """Return the probes of a server: one that sees its start at once, a rare one afterwards."""
    return {
        "startupProbe": {**check, "periodSeconds": 1, "failureThreshold": 300},
        "readinessProbe": {**check, "periodSeconds": 10},
    }


def port(name: str, number: int, protocol: str) -> Object:
    """Return the container's side of a port."""
    return {"name": name, "containerPort": number, "protocol": protocol}


def server_service(plan: NetworkPlan, name: str, number: int, protocol: str) -> Object:
    """Return the Service that clients know a server by."""
    entry = {"name": "server", "port": number, "targetPort": number, "protocol": protocol}
    made = service(around(plan), name, [entry])
    if protocol == "UDP":
        made["spec"]["ipFamilies"] = ["IPv4"]  # Fast DDS is told to use no other
    return made


def server_deployment(plan: NetworkPlan, network: Network, name: str, container: Object) -> Object:
    """Return a server's Deployment: there before its clients, never twice at once.

    Its pods do not say how they are networked: nobody asks whether they find each other.
    """
    volume, mount = inpod_volume(plan.release)
    image = str(network.image or (plan.pods[0].image if plan.pods else around(plan).default_image))
    whole = {
        **container,
        "image": image,
        "lifecycle": stop_hook(),
        "volumeMounts": [mount],
    }
    account = network.service_account
    pod = {"containers": [whole], "volumes": [volume], "serviceAccountName": account}
    return deployment(
        around(plan),
        name,
        compact(pod),
        strategy={"type": "Recreate"},
        annotations={FIRST_ANNOTATION: "true"},
    )


def discovery_wiring(plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
    """Return what makes a pod a client of the discovery servers."""
    servers = ";".join(f"{name}:{DISCOVERY_PORT}" for name in server_names(plan.release, network))
    return Wiring(
        env={"ROS_DISCOVERY_SERVER": {"value": servers}, **udp_only(plan)},
        annotations=network_note(plan),
    )


def zenoh_wiring(plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
    """Return what makes a pod a client of the router, for which it waits as long as it takes."""
    [router] = server_names(plan.release, network)
    override = f'mode="client";connect/endpoints=["tcp/{router}:{ZENOH_PORT}"]'
    return Wiring(
        env={
            "ZENOH_CONFIG_OVERRIDE": {"value": override},
            "ZENOH_ROUTER_CHECK_ATTEMPTS": {"value": "0"},
        },
        annotations=network_note(plan),
    )
