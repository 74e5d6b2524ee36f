"""A participant for a few seconds: announces itself, asks others, notes the answers. Python 3.

Why: a participant answers an announcement at once. So a stand-in in a pod's network discovers what
the pod's own participant would, without waiting for the next round of announcements.
Contract: sockets only on the interfaces it is given; it takes its announcement back when it closes,
and has no endpoints to match. Every DDS ignores its beacons.
"""

import os
import select
import socket

import interfaces
import rtps
import spdp

NAME = "rigel-k8s graph check"  # what a tool that lists participants shows
LEASE = 5  # seconds; others forget it even if its farewell is lost
#: It announces and detects participants, and has nothing else to match.
ENDPOINTS = 0x01 | 0x02


class StandIn(object):
    """A short-lived participant of one domain on some interfaces.

    Attributes:
        participants: prefix -> what was announced, with `from`, the addresses it came from.
        beacons: text -> interface -> how often it was heard.
        servers: the names of those discovery servers that answered.
        sent: how many packets it has sent.
    """

    def __init__(self, domain, addresses):
        """`addresses` is interface -> IPv4 address."""
        self.domain, self.addresses = domain, addresses
        self.prefix = os.urandom(12)
        self.participants, self.beacons, self.servers, self.sent = {}, {}, set(), 0
        self._asked, self._as_client = set(), {}
        self._ears = {_ear(name, domain): name for name in addresses}
        self._mouths = {name: _mouth(name, address) for name, address in addresses.items()}

    def announce(self):
        """Announce it on the domain's multicast group."""
        for name in self._mouths:
            self._send(name, self._announcement(name, self.prefix, rtps.UNKNOWN), self._group())

    def ask(self, address, port, interface=None):
        """Announce it to one participant, which may be behind another address (a Service)."""
        self._asked.add((address, port))
        for name in [interface] if interface else self._mouths:
            self._send(name, self._announcement(name, self.prefix, rtps.UNKNOWN), (address, port))

    def ask_server(self, name, target):
        """Announce it to a discovery server of Fast DDS, with a prefix of its own for its answer.

        The answer is another message than participants send. If the server is behind a Service, it
        comes from another address than the one asked.
        """
        prefix, _ = self._as_client.setdefault(name, (os.urandom(12), target))
        for mouth in self._mouths:
            self._send(mouth, self._announcement(mouth, prefix, rtps.FAST_DDS), target)

    def beacon(self, text):
        """Send a text to all stand-ins of the group."""
        for name in self._mouths:
            self._send(name, rtps.beacon(self.prefix, text), self._group())

    def listen(self, seconds):
        """Receive what arrives within that time, once."""
        sockets = list(self._ears) + list(self._mouths.values())
        for ready in select.select(sockets, [], [], seconds)[0]:
            message, source = ready.recvfrom(65536)
            try:
                self._take(message, source[0], self._ears.get(ready))
            except rtps.Malformed:
                pass  # another program's packet

    def close(self):
        """Take the announcement back from all that may have it."""
        message = spdp.farewell(self.prefix)
        for name, mouth in self._mouths.items():
            for target in [self._group(), *self._asked]:
                self._send(name, message, target)
            for prefix, target in self._as_client.values():
                self._send(name, spdp.farewell(prefix, rtps.FAST_DDS), target)
            mouth.close()
        for ear in self._ears:
            ear.close()

    def _take(self, message, source, ear):
        text = rtps.beacon_text(message)
        if text is not None and ear:
            heard = self.beacons.setdefault(text, {})
            heard[ear] = heard.get(ear, 0) + 1
        if self._as_client:
            self._take_answer(rtps.addressee(message))
        for found, leaves in spdp.announced(message):
            if found.prefix == self.prefix or found.name == NAME or leaves:
                continue
            known = self.participants.setdefault(found.prefix.hex(), as_json(found))
            if source not in known["sources"]:
                known["sources"].append(source)

    def _take_answer(self, addressee):
        for name, (prefix, _) in self._as_client.items():
            if addressee == prefix:
                self.servers.add(name)

    def _announcement(self, name, prefix, vendor):
        mouth = self._mouths[name]
        port = mouth.getsockname()[1]
        places = ((self.addresses[name], port),)
        own = spdp.Announcement(prefix, vendor, self.domain, NAME, meta=places, data=places)
        return spdp.announcement(own._replace(lease=LEASE, endpoints=ENDPOINTS))

    def _group(self):
        return rtps.GROUP, rtps.announcement_port(self.domain)

    def _send(self, name, message, target):
        try:
            self._mouths[name].sendto(message, target)
            self.sent += 1
        except OSError:
            pass  # no route: then no answer comes, and that is what is reported


def as_json(announced):
    """Return a participant as JSON has it; its `sources` are added later."""
    return {
        "prefix": announced.prefix.hex(),
        "vendor": rtps.vendor_name(announced.vendor),
        "domain": announced.domain,
        "name": announced.name,
        "user_data": announced.user_data,
        "locators": list(announced.meta),
        "lease": announced.lease,
        "sources": [],
    }


def _ear(name, domain):
    """Return a socket that receives the group on one interface, and nothing else."""
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    ear.bind((rtps.GROUP, rtps.announcement_port(domain)))
    ear.setsockopt(socket.IPPROTO_IP, interfaces.IP_MULTICAST_ALL, 0)
    joined = interfaces.membership(rtps.GROUP, name)
    ear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
    return ear


def _mouth(name, address):
    """Return a socket that sends through one interface and receives the answers."""
    mouth = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    mouth.bind((address, 0))
    joined = interfaces.membership(rtps.GROUP, name)
    mouth.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, joined)
    return mouth
