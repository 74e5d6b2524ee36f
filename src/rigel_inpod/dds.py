"""How does DDS look from inside this pod? Two lines of JSON: what is here, and what was heard.

Why: a ready pod may still be deaf. A stand-in in a pod's network discovers what the pod's own
participant would discover; and the beacons that it hears show which machines' multicast arrives.

    dds.py [--domain N] [--interface NAME] [--announce] [--beacon TEXT] [--ask ADDRESS]...
           [--server ADDRESS:PORT]... [--router PORT] [--seconds S]

Contract: the first line is the pod's own state, written as soon as the stand-in listens. The second
line is what it heard, written when a line arrives on standard input, and after --seconds (10) in
any case. Without --domain it is in that of the container's own participant, without --interface on
all but the loopback. --announce: by multicast; --ask: participants at an address, at the domain's
first ports; --server: a discovery server; --beacon: a text for the other stand-ins, ten a second;
--router: also list the connections to a zenoh router's port. Exit code 0, 2 for wrong arguments.
Python 3.6 and newer, nothing but the standard library.
"""

import argparse
import json
import os
import select
import socket
import sys
import time

import dds_local
import interfaces
import rtps
from dds_standin import StandIn

TICK = 0.1  # seconds between two beacons
AGAIN = 0.5  # seconds until a participant is asked again: a packet may get lost
SERVER = 11811  # a discovery server's default port
FIRST_PORTS = 4  # how many participants of an address are asked, as Fast DDS does


def read_arguments(words):
    """Return the words of the command line; end with exit code 2 if they are wrong."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--domain", type=int)
    parser.add_argument("--interface")
    parser.add_argument("--announce", action="store_true")
    parser.add_argument("--beacon")
    parser.add_argument("--ask", action="append", default=[])
    parser.add_argument("--server", action="append", default=[])
    parser.add_argument("--router", type=int)
    parser.add_argument("--seconds", type=float, default=10.0)
    return parser.parse_args(words)


class Look(object):
    """One look around: the container's own participants, and what a stand-in hears."""

    def __init__(self, arguments):
        """Prepare; nothing is sent yet."""
        self.arguments = arguments
        self.until = time.time() + arguments.seconds
        self.interfaces = interfaces.addresses()
        wanted = [arguments.interface] if arguments.interface else list(self.interfaces)
        usable = {name: self.interfaces.get(name) for name in wanted}
        self.own = dds_local.participants()
        self.domain = self._domain()
        self.standin = StandIn(self.domain, {n: a for n, a in usable.items() if a})
        ports = [rtps.participant_port(self.domain, i) for i in range(FIRST_PORTS)]
        self.targets = [(a, p) for a in map(resolve, arguments.ask) if a for p in ports]
        self.servers = {word: address_of(word) for word in arguments.server}

    def _domain(self):
        if self.arguments.domain is not None:
            return self.arguments.domain
        return next((p.domain for p in self.own if p.domain is not None), 0)

    def run(self):
        """Print what is here, listen until the end, print what was heard."""
        write(self.here())
        started = beacon = time.time()
        rounds = [started, started + AGAIN]
        while time.time() < self.until and not is_enough():
            if rounds and time.time() >= rounds[0]:
                rounds.pop(0)
                self._ask()
            if self.arguments.beacon and time.time() >= beacon:
                beacon += TICK
                self.standin.beacon(self.arguments.beacon)
            self.standin.listen(TICK / 2)
        self.standin.close()
        write(self.heard())

    def here(self):
        """Return the container's own state."""
        return {
            "interfaces": self.interfaces,
            "down": [name for name in self.interfaces if not interfaces.is_up(name)],
            "participants": [of_process(process) for process in self.own],
            "routers": self._routers(),
        }

    def _routers(self):
        port = self.arguments.router
        return sorted({peer for peer, _ in dds_local.connections(port)}) if port else []

    def heard(self):
        """Return what the stand-in has heard."""
        found = self.standin.participants.values()
        return {
            "participants": [dict(one, own=self._is_own(one)) for one in found],
            "beacons": self.standin.beacons,
            "servers": {word: word in self.standin.servers for word in self.servers},
            "sent": self.standin.sent,
        }

    def _ask(self):
        if self.arguments.announce:
            self.standin.announce()
        for address, port in self.targets:
            self.standin.ask(address, port)
        for word, address in self.servers.items():
            if address:
                self.standin.ask_server(word, address)
        for process in self.own:
            if process.domain == self.domain:
                self._ask_own(process)

    def _ask_own(self, process):
        """Ask a participant of this container, at a port where only that one can answer."""
        for found in process.sockets:
            if dds_local.is_unicast(found.port):
                address = None if found.address == "0.0.0.0" else found.address
                for interface, mine in self.standin.addresses.items():
                    if address in (None, mine):
                        self.standin.ask(mine, found.port, interface)

    def _is_own(self, announced):
        """Whether a participant is this container's: it announces one of its sockets."""
        ports = {s.port for process in self.own for s in process.sockets}
        mine = set(self.interfaces.values()) | {"127.0.0.1"}
        return any(address in mine and port in ports for address, port in announced["locators"])


def of_process(process):
    """Return a process with a participant as JSON has it."""
    return {
        "pid": process.pid,
        "command": process.command,
        "domain": process.domain,
        "stopped": process.stopped,
        "ports": sorted({s.port for s in process.sockets}),
    }


def address_of(server):
    """Return (address, port) of a discovery server's HOST:PORT, None if the host has no address."""
    name, _, port = server.partition(":")
    address = resolve(name)
    return (address, int(port or SERVER)) if address else None


def resolve(name):
    """Return a name's first IPv4 address, None if it has none."""
    try:
        return socket.gethostbyname(name)
    except OSError:
        return None


def is_enough():
    """Whether a line has arrived on standard input; perhaps no one sends one."""
    return bool(select.select([0], [], [], 0)[0] and os.read(0, 100))


def write(value):
    """Write one line of JSON."""
    sys.stdout.write(json.dumps(value, sort_keys=True) + "\n")
    sys.stdout.flush()


def main(words):
    """Run the script."""
    Look(read_arguments(words)).run()


if __name__ == "__main__":
    main(sys.argv[1:])
