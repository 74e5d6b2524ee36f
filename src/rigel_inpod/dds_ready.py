"""Does this pod take part in DDS? One line and an exit code, for ROS 2 and plain DDS alike.

Why: a pod that is "Running" may have no second network, another domain, or a process that hangs.
All this is visible inside the pod; no other participant is needed, so no pod waits for another one.

    dds_ready.py dds [--domain N] [--interface NAME] [--wait SECONDS]    any domain without N
    dds_ready.py dds --port N [--wait SECONDS]         a discovery server's port
    dds_ready.py zenoh --port N [--wait SECONDS]       the router's port
        dds_ready.py ... --node /NODE           and this node exists (ROS 2, see below)
        dds_ready.py ... --transitions /NODE    and the transitions of this node are made
        dds_ready.py ... --components /NODE     and the components of this node are loaded

Contract: exit code 0 ready, 1 not ready, 2 wrong arguments; one line on standard output has the
cause: the kubelet makes it the probe event's message. It sends one packet to each of the
container's own participants, which they must ignore, and sees in /proc whether they read it; none
leaves the pod. With RIGEL_RMW, the directory of the layer's notes (rmw.sh), it asks more: the node
exists, and its executor turns; with RIGEL_K8S_PEERS, too, its pod works, and does not wait to take
over. Python 3.6 and newer, nothing but the standard library.
"""

import os
import sys
import time

import container
import dds_local
import interfaces
import rtps

try:
    import _socket as socket  # half of `import socket` is for classes that are not needed here
except ImportError:  # not CPython
    import socket

READS = 8.0  # seconds that a participant has to read what it was sent; a busy machine needs some
TICK = 0.2  # seconds between two looks while waiting
#: The script that works beside a node, by the option that requests it.
BESIDE = {
    "--transitions": "transitions.py",
    "--components": "components.py",
}


class NotReady(Exception):
    """The message is the cause, in one line."""


class Arguments(object):
    """The words of the command line."""

    def __init__(self, words):
        """Raise ValueError if they are wrong."""
        self.kind, words = words[0] if words else "", words[1:]
        values = {words[i]: words[i + 1] for i in range(0, len(words) - 1, 2)}
        known = {"--domain", "--interface", "--node", "--port", "--wait", *BESIDE}
        if self.kind not in ("dds", "zenoh") or len(words) % 2 or set(values) - known:
            usage = "dds|zenoh [--domain N|--port N] [--interface NAME] [--wait SECONDS]"
            raise ValueError(usage + " [--node|--transitions|--components /NODE]")
        self.domain = int(values["--domain"]) if "--domain" in values else None
        self.port = int(values["--port"]) if "--port" in values else None
        self.interface = values.get("--interface")
        self.node = values.get("--node")
        self.beside = [(script, values[key]) for key, script in BESIDE.items() if key in values]
        self.wait = float(values.get("--wait", 0))
        if self.kind == "zenoh" and self.port is None:
            raise ValueError("zenoh needs --port N, the router's port")


def look(arguments):
    """Return what is ready, in one line; raise NotReady otherwise."""
    if arguments.interface:
        check_interface(arguments.interface)
    lines = [check_zenoh(arguments.port)] if arguments.kind == "zenoh" else look_dds(arguments)
    directory = os.environ.get("RIGEL_RMW")
    if directory:
        import rmw_ready  # other pods do not need it

        try:
            lines += rmw_ready.look(directory, arguments.node, "RIGEL_K8S_PEERS" in os.environ)
        except rmw_ready.NotReady as why:
            raise NotReady(str(why))
    if arguments.beside:
        import progress  # other nodes do not need it

        for script, node in arguments.beside:
            ready, line = progress.describe(script, node)
            if not ready:
                raise NotReady(line)
            lines.append(line)
    return ", ".join(lines)


def look_dds(arguments):
    """Return the container's processes that take part in DDS, each in one line."""
    found = own(arguments.domain, arguments.port)
    for process in found:
        check_process(process, arguments.port)
    return [describe(process, arguments.port) for process in found]


def describe(process, port):
    """Return a process and where it takes part."""
    return "%s at %s" % (process, "port %d" % port if port else "domain %s" % process.domain)


def check_interface(name):
    """Check that the second network is there."""
    if name not in interfaces.addresses():
        text = "%s is missing: Multus did not attach the second network when this pod was made; "
        raise NotReady((text + "delete the pod once Multus runs on its machine") % name)
    if interfaces.address_of(name) is None:
        raise NotReady("%s has no IPv4 address, so DDS cannot use it" % name)
    if not interfaces.is_up(name):
        raise NotReady("%s is down" % name)


def own(domain, port):
    """Return the container's processes that take part."""
    found = dds_local.residents([port] if port else ())
    if port:
        wanted = [process for process in found if process.domain is None]
        if not wanted:
            raise NotReady("no process of this container has UDP port %d yet" % port)
        return wanted
    known = [process for process in found if process.domain is not None]
    wanted = [process for process in known if domain in (None, process.domain)]
    if not wanted and known:
        text = "%s takes part in DDS domain %s instead of %s: is its domain id set in the image?"
        raise NotReady(text % (known[0], known[0].domain, domain))
    if not wanted:
        text = "no process of this container takes part in DDS domain %s yet (UDP port %d)"
        if domain is None:
            raise NotReady("no process of this container takes part in DDS yet")
        raise NotReady(text % (domain, rtps.announcement_port(domain)))
    return wanted


def check_process(process, port):
    """Check that a process runs, and reads what is sent to its participants."""
    if process.stopped:
        raise NotReady("%s is stopped by a signal" % process)
    domain = [s for s in process.sockets if s.port == port]
    domain += [s for s in process.find_unicast() if rtps.domain_of(s.port) == process.domain]
    group = rtps.announcement_port(process.domain or 0)
    for found in domain or [s for s in process.sockets if s.port == group]:
        if not reads(found):
            text = "%s hangs: what was sent to its UDP port %d was not read within %.0f s"
            raise NotReady(text % (process, found.port, READS))


def reads(found):
    """Whether a process reads what is sent to a socket."""
    mouth = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    target = "127.0.0.1" if found.address == "0.0.0.0" else found.address
    mouth.sendto(rtps.beacon(os.urandom(12)), (target, found.port))
    mouth.close()
    return dds_local.is_read(found.inode, READS)


def check_zenoh(port):
    """Check that a process of this container is connected to the router."""
    visitors = container.visitors()
    found = [(peer, pid) for peer, pid in dds_local.connections(port) if pid not in visitors]
    if not found:
        text = "no process of this container is connected to a zenoh router yet (TCP port %d)"
        raise NotReady(text % port)
    for _, pid in found:
        if pid and dds_local.state(pid) in dds_local.STOPPED:
            raise NotReady("process %d is stopped by a signal" % pid)
    return "connected to the zenoh router at %s" % found[0][0]


def main(words):
    """Run the probe and return its exit code."""
    try:
        arguments = Arguments(words)
    except ValueError as error:
        sys.stdout.write("wrong arguments: %s\n" % error)
        return 2
    until = time.time() + arguments.wait
    while True:
        try:
            line = look(arguments)
        except NotReady as error:
            if time.time() + TICK >= until:
                sys.stdout.write("%s\n" % error)
                return 1
            time.sleep(TICK)
        else:
            sys.stdout.write("ready: %s\n" % line)
            return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
