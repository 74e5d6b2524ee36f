"""What is wrong with a job's `network`, or cannot work with its ROS, RMW and workloads; pure.

Whether the cluster has what a mode needs is asked before a deploy, not here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.podchecks import check_pods, workloads_of
from rigel_k8s.network.dds import EARLY
from rigel_k8s.network.options import Install, Network
from rigel_k8s.network.plan import ATTACHED, middleware_word, network_of
from rigel_k8s.network.rangechecks import check_peers, check_ranges
from rigel_k8s.objects.naming import Ros
from rigel_k8s.problems import Problem

__all__ = ["check_install", "check_network"]

MULTUS, SERVERS = ("macvlan", "ipvlan", "attachment"), ("discovery-server", "zenoh")
#: Which modes read a key; those of all modes are left out.
READERS = {
    "interface": ("macvlan", "ipvlan", "host"),
    "subnet": MULTUS,
    "ipam": MULTUS,
    "range_start": MULTUS,
    "range_end": MULTUS,
    "exclude": MULTUS,
    "gateway": ("macvlan", "ipvlan"),
    "routes": ("macvlan", "ipvlan"),
    "mtu": ("macvlan", "ipvlan"),
    "attachment": ("attachment",),
    "servers": ("discovery-server",),
    "image": SERVERS,
    "command": SERVERS,
    "service_account": SERVERS,
    "peers": ("peers",),
    "install": MULTUS,
}
#: What only they read who are told which addresses there are.
OF_RANGES = ("subnet", "range_start", "range_end", "exclude", "gateway", "routes")

#: The last domain, and those whose ports Linux gives to any program (32768 to 60999).
LAST_DOMAIN, UNSAFE = 232, range(102, 215)
LONGEST_INTERFACE = 15
ATTACHMENT = re.compile(r"([a-z0-9]([-a-z0-9]*[a-z0-9])?/)?[a-z0-9]([-a-z0-9.]*[a-z0-9])?")

MISSING = (
    "no `network`: on most clusters nodes on different machines will not find each other, since pod"
    " networks carry no multicast; say network: macvlan, ipvlan, attachment, peers,"
    " discovery-server, zenoh or host, or none where it is known to work (docs/networking.md)"
)


def check_network(options: OrchestrationOptions, ros: Ros, distro: str) -> Iterator[Problem]:
    """Yield what is wrong, with paths from the root of the options."""
    network = network_of(options.network)
    middleware = middleware_word(options.middleware)
    if ros == "1" and middleware:
        message = "ROS 1 has no middleware to choose: leave it out"
        yield Problem(("middleware",), message, "ros1", at_key=True)
    if network is None:
        yield from check_missing(options, ros)
        return
    yield from check_keys(network)
    yield from check_domain(network, ros)
    yield from check_ros1(network, ros)
    yield from check_middleware(network, ros, distro, middleware)
    yield from check_images(options, middleware or ("zenoh" if network.mode == "zenoh" else None))
    yield from check_needed(network)
    yield from check_ranges(network)
    yield from check_peers(network.peers)
    masters = int(ros == "1" and options.ros_master_uri is None)
    watching = int(options.observability.exporter is not None)
    yield from check_pods(options, network, others=masters + watching)


def check_missing(options: OrchestrationOptions, ros: Ros) -> Iterator[Problem]:
    """Yield that several pods of ROS 2 or DDS have no network to find each other on."""
    if ros != "1" and sum(one.pods for one in workloads_of(options)) > 1:
        path = ("nodes",) if options.nodes else ()
        yield Problem(path, MISSING, "network-missing", severity="warning", at_key=True)


def check_keys(network: Network) -> Iterator[Problem]:
    """Yield keys that the mode does not read."""
    for key, modes in READERS.items():
        if not getattr(network, key):
            continue
        if network.mode not in modes:
            message = (
                f"`{key}` is for {listed(modes)}; {network.mode} does not read it: leave it out"
            )
            yield Problem(("network", key), message, "foreign-key", at_key=True)
        elif key in OF_RANGES and (reason := nobody_asks(network)):
            yield Problem(("network", key), reason, "foreign-key", at_key=True)


def listed(modes: Sequence[str]) -> str:
    """Return modes as a sentence has them."""
    return " and ".join(filter(None, [", ".join(modes[:-1]), modes[-1]]))


def nobody_asks(network: Network) -> str | None:
    """Return why nobody is told of addresses."""
    if network.mode == "attachment" and network.ipam != "static":
        return (
            "the attachment that is there says it; only with `ipam: static` are addresses given"
            " out here"
        )
    if network.ipam == "dhcp":
        return "with dhcp a server of that network says it: leave it out"
    return None


def check_domain(network: Network, ros: Ros) -> Iterator[Problem]:
    """Yield domains that there are none of, or whose ports others may have."""
    domain = network.domain_id
    if domain is None:
        return
    path = ("network", "domain_id")
    if ros == "1":
        yield Problem(path, "ROS 1 has no domains: leave it out", "ros1", at_key=True)
    elif not 0 <= domain <= LAST_DOMAIN:
        yield Problem(path, f"{domain} is not a DDS domain: 0 to {LAST_DOMAIN}", "bad-domain")
    elif domain in UNSAFE:
        message = (
            f"Linux gives the ports of domain {domain} to any program that asks for one, and then"
            " a node does not start; 0 to 101 and 215 to 232 are safe"
        )
        yield Problem(path, message, "bad-domain", severity="warning")


def check_ros1(network: Network, ros: Ros) -> Iterator[Problem]:
    """Yield what ROS 1 cannot do: another discovery, or an address that nobody knows beforehand."""
    if ros != "1":
        return
    if network.mode not in (*MULTUS, "host", "none"):
        message = f"{network.mode} is for ROS 2; nodes of ROS 1 find each other through roscore"
        yield Problem(mode_path(network), message, "ros1")
    elif network.mode in ATTACHED and network.ipam != "static":
        message = (
            "a node of ROS 1 tells the others its address, which must be known before it starts:"
            " say ipam: static, and the subnet to give out addresses from"
        )
        path = ("network", "ipam") if network.ipam else mode_path(network)
        yield Problem(path, message, "ros1")


def mode_path(network: Network) -> tuple[str, ...]:
    """Return where the mode stands: a word alone is the network itself."""
    return ("network",) if network == Network(mode=network.mode) else ("network", "mode")


def check_middleware(
    network: Network, ros: Ros, distro: str, middleware: str | None
) -> Iterator[Problem]:
    """Yield a middleware and a mode that do not go together."""
    where = ("middleware",)
    if network.mode == "zenoh" and ros == "none":
        message = "a plain DDS application speaks no zenoh: use macvlan, peers or host"
        yield Problem(mode_path(network), message, "wrong-mode")
    elif network.mode == "zenoh" and middleware not in (None, "zenoh"):
        message = f"{middleware} finds nobody through a zenoh router: say middleware: zenoh"
        yield Problem(where, message, "wrong-mode")
    elif network.mode == "zenoh" and distro.lower() in EARLY - {"humble"}:
        yield Problem(mode_path(network), f"{distro} has no rmw_zenoh", "wrong-mode")
    elif middleware == "zenoh" and network.mode not in ("zenoh", "none"):
        message = "zenoh finds others through its router, not by DDS: say network: zenoh"
        yield Problem(mode_path(network), message, "wrong-mode")
    elif network.mode == "discovery-server" and middleware not in (None, "fastdds"):
        message = "only Fast DDS has discovery servers: use peers, or middleware: fastdds"
        yield Problem(where, message, "wrong-mode")


def check_images(options: OrchestrationOptions, middleware: str | None) -> Iterator[Problem]:
    """Yield official images that lack the middleware, each place once."""
    if middleware not in ("cyclonedds", "zenoh"):
        return
    for path in dict.fromkeys(one.image for one in workloads_of(options) if one.official):
        message = (
            f"official ROS images carry Fast DDS only: {middleware} wants an image with"
            f" ros-DISTRO-rmw-{middleware}-cpp installed"
        )
        yield Problem(path, message, "image-lacks-rmw", severity="warning")


def check_needed(network: Network) -> Iterator[Problem]:
    """Yield keys that a mode cannot do without, and values that Linux or Kubernetes refuses."""
    ranged = network.ipam != "dhcp" if network.mode != "attachment" else network.ipam == "static"
    wanted = {
        "interface": (network.mode in ("macvlan", "ipvlan"), "of the machines: eth0, say"),
        "subnet": (network.mode in ATTACHED and ranged, "to give out addresses from"),
        "attachment": (network.mode == "attachment", "NAME or NAMESPACE/NAME of one that is there"),
    }
    for key, (needed, what) in wanted.items():
        if needed and getattr(network, key) is None:
            message = f"{network.mode} needs `{key}`: {what}"
            yield Problem(("network",), message, "incomplete", at_key=True)
    yield from check_form(network)


def check_form(network: Network) -> Iterator[Problem]:
    """Yield names that are none, and an IPAM that the mode cannot have."""
    name = network.interface
    if name is not None and not re.fullmatch(rf"[^/\s:]{{1,{LONGEST_INTERFACE}}}", name):
        message = f'"{name}" is no interface of Linux: at most 15 characters, no space, "/" or ":"'
        yield Problem(("network", "interface"), message, "bad-name")
    if network.attachment is not None and not ATTACHMENT.fullmatch(network.attachment):
        message = f'"{network.attachment}" is neither NAME nor NAMESPACE/NAME'
        yield Problem(("network", "attachment"), message, "bad-name")
    if isinstance(network.install, Install):
        for problem in check_install(network.install):
            yield problem.under(("network", "install"))
    if network.mode == "ipvlan" and network.ipam == "dhcp":
        message = "interfaces of ipvlan share one MAC address, so a DHCP server takes them for one"
        yield Problem(("network", "ipam"), message, "wrong-mode")
    if network.mode == "attachment" and network.ipam not in (None, "static"):
        message = "the attachment that is there says who gives out addresses: leave it out"
        yield Problem(("network", "ipam"), message, "foreign-key", at_key=True)


def check_install(options: Install) -> Iterator[Problem]:
    """Yield what of an installation contradicts itself, with paths from the root of its options."""
    if options.data_dir and options.platform not in (None, "k3s"):
        message = f"only k3s has a data directory, and this is {options.platform}"
        yield Problem(("data_dir",), message, "no-k3s")
