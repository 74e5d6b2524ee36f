"""Configuration files of Fast DDS and Cyclone DDS, and the variables that name them.

Pods share no memory unless they are asked to: each has its own /dev/shm. If Fast DDS takes two
such pods for one machine, it writes where no other pod reads. So it gets UDP alone, or UDP and
shared memory where all programs of one address have the same /dev/shm: it then uses shared memory
for those, and UDP for all others. A program whose part of /dev/shm is missing uses UDP alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rigel_k8s.network.wiring import NetworkPlan, PodIdentity

Variables = dict[str, dict[str, Any]]

#: Where a pod finds its configuration files.
FILES_PATH = "/rigel-k8s-network"
FASTDDS_FILE = "fastdds.xml"
#: The same for pods that share memory, in a release where others do not.
SHARED_FILE = "fastdds-shared.xml"
CYCLONE_FILE = "cyclonedds.xml"
#: Placeholder in a file for the pod's address, replaced when the pod starts.
ADDRESS = "@ADDRESS@"
#: What Fast DDS requests for its sockets; it gets at most the machine's net.core.rmem_max.
#: docs/networking.md shows what that means for large messages.
BUFFER = 4 * 2**20
#: The memory that each program that shares it writes its messages into; it holds all of it, always.
#: Beside UDP, Fast DDS cuts messages into fragments of 65,500 bytes, and a reader's queue has 512
#: places: of more at once, a reader loses the rest. The option `sockets_size` is half of it.
SEGMENT = 32 * 10**6
#: How many participants of one address Fast DDS looks for; a program has one.
PARTICIPANTS = 4

#: The variable that names Fast DDS' profiles: that of 2.x, which 3.x warns about, and that of 3.x.
OLD_VARIABLE, NEW_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
#: Distributions whose Fast DDS may not read transports(): it does from 2.14 on.
EARLY = frozenset(
    ("ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic", "humble", "iron")
)
#: Distributions whose Fast DDS is 2.x, and those whose is 3.x.
FASTDDS_2, FASTDDS_3 = EARLY | {"jazzy"}, frozenset({"kilted", "lyrical", "rolling"})


def uses(plan: NetworkPlan, middleware: str) -> bool:
    """Return whether a pod may run a middleware: the options name it, or they name none."""
    return plan.ros.dds and plan.middleware in (None, middleware)


def reads_transports(plan: NetworkPlan) -> bool:
    """Return whether the application's Fast DDS certainly reads transports(), with its options."""
    return plan.ros.rmw and plan.distro.lower() not in EARLY


def shares_memory(plan: NetworkPlan, pod: PodIdentity | None, *, pinned: bool = False) -> bool:
    """Return whether a pod's Fast DDS shares memory with all programs that have its address.

    On a machine's network all pods must have the machine's /dev/shm. Fast DDS 3 discovers no one
    of its own machine-id if it shares memory and is pinned to one interface.
    """
    if not uses(plan, "fastdds") or (pinned and not (plan.ros.rmw and is_fastdds_2(plan.distro))):
        return False
    if plan.options and plan.options.shared_memory:
        return True
    if pod is None or pod.on_machine or plan.on_machine:
        return False
    return pod.shares_memory


def is_fastdds_2(distro: str) -> bool:
    """Return whether a distribution's Fast DDS is 2.x."""
    return distro.lower() in FASTDDS_2


def transports(plan: NetworkPlan, pod: PodIdentity | None = None) -> Variables:
    """Return the variable with Fast DDS' transports, for programs that no profile configures."""
    name, size = ("DEFAULT", SEGMENT // 2) if shares_memory(plan, pod) else ("UDPv4", BUFFER)
    options = f"?sockets_size={size // 10**6}MB" if reads_transports(plan) else ""
    return {"FASTDDS_BUILTIN_TRANSPORTS": {"value": name + options}}


def fastdds_variables(plan: NetworkPlan, pod: PodIdentity, *, pinned: bool = False) -> Variables:
    """Return the variables that name the profiles, for all versions that the pod may have."""
    file = SHARED_FILE if shares_memory(plan, pod, pinned=pinned) else FASTDDS_FILE
    source = {"value": f"{FILES_PATH}/{file}"}
    distro = plan.distro.lower() if plan.ros.rmw else ""
    old = {} if distro in FASTDDS_3 else {OLD_VARIABLE: source}
    new = {} if distro in FASTDDS_2 else {NEW_VARIABLE: source}
    return old | new


def cyclone_variables() -> Variables:
    """Return the variable that names Cyclone's configuration."""
    return {"CYCLONEDDS_URI": {"value": f"file://{FILES_PATH}/{CYCLONE_FILE}"}}


def fastdds_profiles(
    plan: NetworkPlan, address: str | None = None, peers: Sequence[str] = ()
) -> dict[str, str]:
    """Return the files with Fast DDS' profiles that the release's pods read."""
    pinned = address is not None
    shared = {shares_memory(plan, pod, pinned=pinned) for pod in (*plan.pods, None)}
    return {
        SHARED_FILE if one else FASTDDS_FILE: fastdds_profile(address, peers, shared_memory=one)
        for one in sorted(shared)
    }


def fastdds_profile(
    address: str | None = None, peers: Sequence[str] = (), *, shared_memory: bool = False
) -> str:
    """Return Fast DDS' default profile: UDP on one interface, with initial peers.

    Args:
        address: the interface's own. 2.6 takes no names of interfaces; all others take addresses.
        peers: addresses or names, each tried on the ports of its first four participants.
        shared_memory: use shared memory too.
    """
    udp = element(
        "transport_descriptor",
        leaf("transport_id", "rigel"),
        leaf("type", "UDPv4"),
        leaf("sendBufferSize", str(BUFFER)),
        leaf("receiveBufferSize", str(BUFFER)),
        element("interfaceWhiteList", leaf("address", address) if address else []),
    )
    memory = element(
        "transport_descriptor",
        leaf("transport_id", "rigel-memory"),
        leaf("type", "SHM"),
        leaf("segment_size", str(SEGMENT)),
    )
    locators = [element("locator", element("udpv4", leaf("address", peer))) for peer in peers]
    rtps = element(
        "rtps",
        element("builtin", element("initialPeersList", *locators)),
        element(
            "userTransports",
            leaf("transport_id", "rigel-memory") if shared_memory else [],
            leaf("transport_id", "rigel"),
        ),
        leaf("useBuiltinTransports", "false"),
    )
    default = ' profile_name="rigel" is_default_profile="true"'
    participant = element("participant", rtps, attributes=default)
    descriptors = element("transport_descriptors", udp, memory if shared_memory else [])
    profiles = element("profiles", descriptors, participant)
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


def pinned_variables(plan: NetworkPlan, pod: PodIdentity) -> Variables:
    """Return the variables that name the files of pinned_files()."""
    fast = fastdds_variables(plan, pod, pinned=True) if uses(plan, "fastdds") else {}
    return fast | (cyclone_variables() if uses(plan, "cyclonedds") else {})


def pinned_files(plan: NetworkPlan, interface: str) -> dict[str, str]:
    """Return the files that pin DDS to one interface."""
    found = fastdds_profiles(plan, ADDRESS) if uses(plan, "fastdds") else {}
    if uses(plan, "cyclonedds"):
        found[CYCLONE_FILE] = cyclone_config(interface)
    return found


#: The little XML that the files need is made of lines.
ESCAPES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def leaf(name: str, text: str) -> list[str]:
    return [f"<{name}>{text.translate(ESCAPES)}</{name}>"]


def element(name: str, *children: Sequence[str], attributes: str = "") -> list[str]:
    """Return an element around others; without any, nothing."""
    inside = [f"  {line}" for child in children for line in child]
    return [f"<{name}{attributes}>", *inside, f"</{name}>"] if inside else []


def document(lines: Iterable[str]) -> str:
    """Return a whole file's text."""
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *lines, ""])
