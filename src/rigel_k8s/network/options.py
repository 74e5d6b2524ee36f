"""The options of `network`: how the pods of an application reach and discover each other."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import attrs

from rigel_k8s.objects.fields import option, true_is_default
from rigel_k8s.objects.podoptions import Machines
from rigel_k8s.objects.scalars import Count, DottedName, ImageRef, MountPath, Servers

#: The names of the modes; modes/ has one module each.
ModeName = Literal["macvlan", "attachment", "peers", "discovery-server", "zenoh", "host", "none"]

#: The second network's interface in a pod, as Multus names it.
INTERFACE = "net1"
#: Where zenoh's router listens.
ZENOH_PORT = 7447

#: What a Rigelfile may call a middleware, and what ROS 2 calls it (RMW_IMPLEMENTATION).
MIDDLEWARE = {
    "fastdds": "rmw_fastrtps_cpp",
    "cyclonedds": "rmw_cyclonedds_cpp",
    "zenoh": "rmw_zenoh_cpp",
}


@attrs.frozen(kw_only=True)
class Install:
    """Multus and whereabouts on the cluster; what is not set is detected from the cluster."""

    platform: Literal["k3s", "microk8s", "kind", "minikube", "plain"] | None = option(
        "the kind of cluster, if it cannot be detected"
    )
    data_dir: MountPath | None = option("k3s' --data-dir (default /var/lib/rancher/k3s)")
    cni_conf_dir: MountPath | None = option("where the machines keep CNI configuration")
    cni_bin_dir: MountPath | None = option("where the machines keep CNI programs")
    multus_image: ImageRef | None = option("Multus' image, from a registry of your own")
    whereabouts_image: ImageRef | None = option("whereabouts' image, from a registry of your own")
    plugins_image: ImageRef | None = option(
        "an image with the standard CNI programs in /opt/cni/bin, for machines without macvlan"
    )


@attrs.frozen(kw_only=True)
class Network:
    """How pods reach and discover each other."""

    foreign: ClassVar[Mapping[str, str]] = dict.fromkeys(("name", "type"), "write `mode`")

    mode: ModeName = option(
        "macvlan or attachment: a second interface by Multus; peers, discovery-server or zenoh:"
        " over the pod network; host: the machine's own network; none: nothing is done",
        "macvlan",
    )
    interface: str | None = option(
        "macvlan: the machines' interface, such as eth0; host: the only one that DDS uses"
    )
    shared_memory: bool = option(
        "host: Fast DDS uses the machine's shared memory (hostIPC) between nodes of one machine",
        default=False,
    )
    subnet: str | None = option("the second network's addresses, such as 10.20.0.0/24")
    ipam: Literal["whereabouts", "static", "host-local"] | None = option(
        "who gives out addresses: whereabouts (the default), static (`rigel`, one for each"
        " workload, which keeps it), host-local (one machine only)"
    )
    range_start: str | None = option("the first address to give out")
    range_end: str | None = option("the last address to give out")
    exclude: list[str] = option("addresses or ranges never to give out", [])
    gateway: str | None = option("the second network's gateway, if it has one")
    routes: list[str] = option("further ranges that `gateway` leads to", [])
    mtu: Count | None = option("the second interface's MTU (default: the machine's)")
    attachment: str | None = option(
        "attachment: an existing NetworkAttachmentDefinition, NAME or NAMESPACE/NAME"
    )
    domain_id: int | None = option(
        "the DDS domain, ROS_DOMAIN_ID (default: 0, or over the pod network one that differs by"
        " release)"
    )
    servers: Servers | None = option("discovery-server: how many (default 1)")
    image: ImageRef | None = option(
        "discovery-server and zenoh: the server's image (default: that of the first node); a new"
        " build of it restarts the servers"
    )
    command: str | list[str] | None = option(
        "discovery-server and zenoh: the server's command, run by its image's ENTRYPOINT;"
        " $(SERVER_ID) and $(SERVER_NAME) are a discovery server's place and name"
    )
    peers: list[str] = option("peers: addresses or names of participants outside the release", [])
    service_account: DottedName | None = option(
        "discovery-server and zenoh: serviceAccountName of the servers' pods"
    )
    placement: Machines | None = option(
        "discovery-server and zenoh: the machines that the servers may run on"
    )
    install: Install | None = option(
        "install Multus and whereabouts first, if the cluster does not have them",
        default=False,
        accepts=bool | Install,
        converter=true_is_default(Install),
    )


def network_of(value: Network | ModeName | None) -> Network | None:
    """Return the options of a network that may be written as a word, short for its mode."""
    return Network(mode=value) if isinstance(value, str) else value


def middleware_name(value: str | None) -> str | None:
    """Return fastdds, cyclonedds or zenoh for any of a middleware's names."""
    if value is None:
        return None
    return value.removeprefix("rmw_").removesuffix("_cpp").replace("fastrtps", "fastdds")
