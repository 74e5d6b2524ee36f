"""Configuration files of Fast DDS and Cyclone DDS, and the variables that name them.

Pods never share memory: each has its own /dev/shm. If Fast DDS takes two pods for one machine, it
writes where no other pod reads. A profile that names its transports leaves shared memory out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rigel_k8s.network.wiring import NetworkPlan

Variables = dict[str, dict[str, Any]]

#: Where a pod finds its configuration files.
FILES_PATH = "/rigel-k8s-network"
FASTDDS_FILE = "fastdds.xml"
CYCLONE_FILE = "cyclonedds.xml"
#: Placeholder in a file for the pod's address, replaced when the pod starts.
ADDRESS = "@ADDRESS@"
#: What Fast DDS requests for its sockets; it gets at most the machine's net.core.rmem_max.
#: docs/networking.md shows what that means for large messages.
BUFFER = 4 * 2**20
#: How many participants of one address Fast DDS looks for; a program has one.
PARTICIPANTS = 4

#: The variable that names Fast DDS' profiles: that of 2.x, which 3.x warns about, and that of 3.x.
OLD_VARIABLE, NEW_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
#: Distributions whose Fast DDS may not read udp_only(): it does from 2.14 on.
EARLY = frozenset(
    ("ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic", "humble", "iron")
)
#: Distributions whose Fast DDS is 2.x, and those whose is 3.x.
FASTDDS_2, FASTDDS_3 = EARLY | {"jazzy"}, frozenset({"kilted", "lyrical", "rolling"})


def uses(plan: NetworkPlan, middleware: str) -> bool:
    """Return whether a pod may run a middleware: the options name it, or they name none."""
    return plan.ros.dds and plan.middleware in (None, middleware)


def reads_udp_only(plan: NetworkPlan) -> bool:
    """Return whether the application's Fast DDS certainly reads udp_only(), with its options."""
    return plan.ros.rmw and plan.distro.lower() not in EARLY


def udp_only(plan: NetworkPlan) -> Variables:
    """Return the variable that keeps Fast DDS from shared memory if no profile does."""
    options = f"?sockets_size={BUFFER // 10**6}MB" if reads_udp_only(plan) else ""
    return {"FASTDDS_BUILTIN_TRANSPORTS": {"value": f"UDPv4{options}"}}


def fastdds_variables(plan: NetworkPlan) -> Variables:
    """Return the variables that name the profiles, for all versions that the pod may have."""
    source = {"value": f"{FILES_PATH}/{FASTDDS_FILE}"}
    distro = plan.distro.lower() if plan.ros.rmw else ""
    old = {} if distro in FASTDDS_3 else {OLD_VARIABLE: source}
    new = {} if distro in FASTDDS_2 else {NEW_VARIABLE: source}
    return old | new


def cyclone_variables() -> Variables:
    """Return the variable that names Cyclone's configuration."""
    return {"CYCLONEDDS_URI": {"value": f"file://{FILES_PATH}/{CYCLONE_FILE}"}}


def fastdds_profile(address: str | None = None, peers: Sequence[str] = ()) -> str:
    """Return Fast DDS' default profile: UDP alone, on one interface, with initial peers.

    Args:
        address: the interface's own. 2.6 takes no names of interfaces; all others take addresses.
        peers: addresses or names, each tried on the ports of its first four participants.
    """
    transport = element(
        "transport_descriptor",
        leaf("transport_id", "rigel"),
        leaf("type", "UDPv4"),
        leaf("sendBufferSize", str(BUFFER)),
        leaf("receiveBufferSize", str(BUFFER)),
        element("interfaceWhiteList", leaf("address", address) if address else []),
    )
    locators = [element("locator", element("udpv4", leaf("address", peer))) for peer in peers]
    rtps = element(
        "rtps",
        element("builtin", element("initialPeersList", *locators)),
        element("userTransports", leaf("transport_id", "rigel")),
        leaf("useBuiltinTransports", "false"),
    )
    default = ' profile_name="rigel" is_default_profile="true"'
    participant = element("participant", rtps, attributes=default)
    profiles = element("profiles", element("transport_descriptors", transport), participant)
    return document(element("dds", profiles, attributes=' xmlns="http://www.eprosima.com"'))


#: How often Cyclone DDS announces itself to its peers; Fast DDS does so each 3 s.
ANNOUNCED = "3s"


def cyclone_config(
    interface: str | None = None, peers: Sequence[str] = (), *, multicast: bool = True
) -> str:
    """Return Cyclone DDS' configuration, for 0.9 to 11.

    Args:
        interface: the name of the only one to use; if it is missing, the program ends.
        peers: addresses or names, with or without a port.
        multicast: whether multicast reaches other pods.
    """
    chosen = [f'<NetworkInterface name="{interface}"/>'] if interface else []
    general = element(
        "General",
        element("Interfaces", chosen),
        [] if multicast else leaf("AllowMulticast", "false"),
    )
    # Without an index, others cannot compute a participant's port; before 11 none had an index.
    index = [
        *leaf("ParticipantIndex", "auto"),
        *leaf("MaxAutoParticipantIndex", "32"),
    ]
    listed = element("Peers", [f'<Peer address="{peer}"/>' for peer in peers])
    # A Service leads to ready pods only, and by default Cyclone announces itself each 30 s.
    often = leaf("SPDPInterval", ANNOUNCED)
    discovery = element("Discovery", index, often, listed) if peers else []
    return document(element("CycloneDDS", element("Domain", general, discovery)))


def pinned_variables(plan: NetworkPlan) -> Variables:
    """Return the variables that name the files of pinned_files()."""
    fast = fastdds_variables(plan) if uses(plan, "fastdds") else {}
    return fast | (cyclone_variables() if uses(plan, "cyclonedds") else {})


def pinned_files(plan: NetworkPlan, interface: str) -> dict[str, str]:
    """Return the files that pin DDS to one interface."""
    found = {}
    if uses(plan, "fastdds"):
        found[FASTDDS_FILE] = fastdds_profile(ADDRESS)
    if uses(plan, "cyclonedds"):
        found[CYCLONE_FILE] = cyclone_config(interface)
    return found


#: The little XML that the files need is made of lines.
ESCAPES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def leaf(name: str, text: str) -> list[str]:
    """Return an element with a text."""
    return [f"<{name}>{text.translate(ESCAPES)}</{name}>"]


def element(name: str, *children: Sequence[str], attributes: str = "") -> list[str]:
    """Return an element around others; without any, nothing."""
    inside = [f"  {line}" for child in children for line in child]
    return [f"<{name}{attributes}>", *inside, f"</{name}>"] if inside else []


def document(lines: Iterable[str]) -> str:
    """Return a whole file's text."""
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *lines, ""])
