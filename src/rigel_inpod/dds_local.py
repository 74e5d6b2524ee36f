"""What a container has for DDS: its processes' sockets, from /proc. Python 3.

Why: "no participant" and "the wrong domain" are found here without a packet. Where several pods
share an address, the listening process shows whose participant it is.
Contract: reads only; of RTPS it uses only the ports (rtps.py).
"""

import time
from struct import pack

import container
import rtps

try:
    import _socket as socket  # half of `import socket` is for classes that are not needed here
except ImportError:  # not CPython
    import socket

GLANCE = 0.001  # seconds until a second look at a socket's queue; then twice as long each time
STOPPED = "Tt"  # a process' state: by a signal, by a debugger
DAEMON = "ros2-daemon"  # of the ros2 command line, left behind by a user of this pod


class Process(object):
    """One of this container's processes that has a participant.

    Attributes:
        pid, command: which one; 0 and "" if the owner is not visible.
        stopped: whether a signal keeps it from running.
        domain: the DDS domain.
        sockets: all its UDP sockets.
    """

    def __init__(self, pid, domain, sockets):
        self.pid, self.domain, self.sockets = pid, domain, sockets
        self.command = container.command(pid) if pid else ""
        self.stopped = bool(pid) and state(pid) in STOPPED

    def find_unicast(self):
        """Return the sockets where a single participant receives announcements.

        The next port is where it receives data: a socket for sending may have any single port.
        """
        ports = {s.port for s in self.sockets}
        return [s for s in self.sockets if _is_unicast(s.port) and s.port + 1 in ports]

    def __str__(self):
        return "process %d (%s)" % (self.pid, self.command) if self.pid else "a process"


class Socket(object):
    """A UDP socket: its address ("0.0.0.0" for any), its port, the bytes that wait to be read."""

    def __init__(self, address, port, waiting, inode):
        self.address, self.port, self.waiting, self.inode = address, port, waiting, inode


def participants(also=()):
    """Return the processes of this container that have a participant, by their UDP sockets.

    Args:
        also: ports that belong to a participant even if they are in no domain (a discovery
            server's).
    """
    found = []
    for pid, sockets in _by_process():
        ports = {s.port for s in sockets}
        found += [Process(pid, domain, sockets) for domain in _domains(ports)]
        if ports.intersection(also):
            found.append(Process(pid, None, sockets))
    return found


def residents(also=()):
    """Return those participants that the container's own command has started; args as above."""
    found, visitors = participants(also), container.visitors()
    return [p for p in found if p.pid not in visitors and DAEMON not in p.command]


def is_read(inode, seconds):
    """Whether the queue of a UDP socket becomes empty in this time, or once becomes shorter.

    One that is sent much may always have something to read.
    """
    until, pause, before = time.time() + seconds, GLANCE, 0
    while True:
        waiting = next((s.waiting for s in udp_sockets() if s.inode == inode), 0)
        if not waiting or waiting < before:
            return True
        if time.time() > until:
            return False
        before = waiting
        time.sleep(pause)
        pause *= 2


def udp_sockets():
    """Return all UDP sockets of this network namespace that are bound to an IPv4 address."""
    return [_socket(fields) for fields in container.read_table("net/udp")]


def connections(port):
    """Return (peer, pid) of this container's established TCP connections to a port."""
    found = [
        (_address(fields[2].partition(":")[0]), fields[9])
        for fields in container.tcp_sockets(container.ESTABLISHED)
        if container.port_of(fields[2]) == port
    ]
    owners = _owners()
    return [(peer, owners.get(inode, 0)) for peer, inode in found if _ours(inode, owners)]


def state(pid):
    """Return a process' state as /proc writes it, "" if it has ended."""
    try:
        with open("/proc/%s/stat" % pid) as file:
            return file.read().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return ""


def _domains(ports):
    """Return the domains of a process: a port that the system chose may lie in a domain's range.

    So two ports are needed: the announcements' port and another one of the domain, or the pair of
    ports that a participant has for itself. With the former, such a pair in another domain is there
    by chance.
    """
    offsets = {}
    for port in ports:
        offsets.setdefault(rtps.domain_of(port), set()).add((port - 7400) % 250)
    offsets.pop(None, None)
    announced = [d for d, found in offsets.items() if 0 in found and len(found) > 1]
    paired = {rtps.domain_of(p) for p in ports if _is_unicast(p) and p + 1 in ports}
    return sorted(announced or paired - {None})


def _is_unicast(port):
    offset = (port - 7400) % 250
    return port >= 7400 and offset >= 10 and offset % 2 == 0


def _by_process():
    """Yield (pid, its UDP sockets); pid 0 for those whose owner is hidden."""
    owners, groups = _owners(), {}
    for found in udp_sockets():
        if _ours(found.inode, owners):
            groups.setdefault(owners.get(found.inode, 0), []).append(found)
    return sorted(groups.items())


def _ours(inode, owners):
    return inode in owners or owners.get("hidden", False)


def _owners():
    """Return socket inode -> pid for this container; "hidden" where some were not shown."""
    owners = {}
    for pid in container.processes():
        try:
            owners.update((inode, pid) for inode in container.sockets(pid))
        except OSError:
            owners["hidden"] = True
    return owners


def _socket(fields):
    address, _, port = fields[1].partition(":")
    return Socket(_address(address), int(port, 16), int(fields[4].partition(":")[2], 16), fields[9])


def _address(text):
    """Return the last IPv4 address in /proc's notation of an address."""
    raw = bytes.fromhex(text[-8:])
    return socket.inet_ntoa(raw[::-1] if _LITTLE else raw)


_LITTLE = pack("=H", 1) == b"\x01\x00"
