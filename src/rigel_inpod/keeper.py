"""Stands beside a ROS 2 node, and agrees with the keepers of its other pods which of them works.

    keeper.py run               beside the node, as long as the container runs
    keeper.py leave --wait S    before the pod ends: another one takes over, if one waits;
                                exits with 0 if another one works then, else with 1
    keeper.py state             prints what it has reached, in one line

Why: handover.py says what is agreed, and how. This is what it needs of the world: sockets, names,
time, and the notes of the node's processes (rmw_notes.py).
Contract: Python 3.6. RIGEL_RMW is the directory of the notes; RIGEL_K8S_WORKLOAD the same for all
pods of a workload; RIGEL_K8S_PEERS a name whose addresses are theirs, without it no pod is looked
for; RIGEL_K8S_PEERS_PORT (11399) the first of the ports, of which a keeper takes the first free
one; RIGEL_K8S_POD its pod; RIGEL_K8S_DRAIN (300) the seconds for goals; RIGEL_K8S_TOGETHER the
containers of its pod that take over together, NAME:NAME, with directories beside its own;
RIGEL_K8S_RATES how often the node must publish before it takes over (rates.py). It ends
with 0 on SIGINT and SIGTERM; after another end it must be started again, and goes on where it was.
The same port answers `GET /notes` with what the processes note. Any program of the pod network may
connect: what is no keeper's is closed at once, and nothing that comes is larger than a limit.
"""

import errno
import json
import os
import select
import signal
import socket
import sys
import threading
import time

import handover
import rates
import rmw_notes
from progress import READY, Progress

PORT, PORTS = 11399, 4
BEFORE, AFTER = 4096, 1 << 22  # bytes of a message from a stranger, and from a keeper
LINKS = 32
GREETING = 2.0  # seconds for a stranger's first message
CONNECTING = 7.5  # seconds for a connection: the kernel asks at 0, 1, 3 and 7 s
AVOID = 10.0  # seconds until an address that is no other keeper of the workload is tried again
#: How often all addresses are tried: for how many seconds after the start and the loss of another
#: one, and with which pause. Later, one that waits goes on so; one that works is found by others.
TRIES, RARELY = ((3.0, 0.2), (300.0, 1.0)), 5.0
#: Seconds for the first answer of the name service. Without it a new pod does not know of an old
#: one, and both would work. In a pod that has worked before, a container starts again sooner.
PATIENCE, BRIEF = 30.0, 2.0
#: The kernel ends a connection when the other one's has been silent for two seconds: its machine
#: is lost, or the network cut. For a keeper that gets no processor time its kernel answers. Set
#: once there is a connection: it would limit the attempts to make one.
CUT = ((socket.TCP_USER_TIMEOUT, 2000), (socket.TCP_KEEPIDLE, 1), (socket.TCP_KEEPINTVL, 1))

SUCCEED = 2.0  # seconds in which another keeper begins to work after this one's goodbye

#: Files beside the notes: what outlasts a run; that the pod ends; whether another one works then;
#: what has been reached.
KEPT, LEAVES, LEFT, PROGRESS = "keeper.json", "leave.json", "left.json", "progress"
#: Why its processes cannot be handed over.
LEFT_OUT = "left-out"
OTHER = "its keeper ended, and the scripts are now of another version of rigel: restart the node"
#: When this container was last fit to take over, and for how many seconds that counts.
FIT, FRESH = "fit.json", 5.0


class Side(rmw_notes.Notes):
    """The node's processes.

    Args:
        others: the directories of other containers of its pod.
        limits: the rates that it must reach, as rates.parse returns them.
    """

    def __init__(self, directory, mode, others=(), limits=()):
        rmw_notes.Notes.__init__(self, directory, mode)
        self.rates = rates.Rates(directory, dict(limits))
        self._own, self._others = os.path.join(directory, FIT), others

    def agree(self, fit):
        """Return whether all containers of the pod are fit to take over, this one included."""
        if self._others:
            write(self._own, {"at": time.monotonic() if fit else 0.0})
        since = time.monotonic() - FRESH
        found = (read(os.path.join(other, FIT)).get("at", 0.0) for other in self._others)
        return fit and all(at >= since for at in found)

    def inside(self):
        """Return how the identifiers of the other containers' processes begin."""
        found = set()
        for other in self._others:
            try:
                with open(os.path.join(other, "control"), "rb") as opened:
                    found.update(rmw_notes.read_friends(opened.fileno()))
            except OSError:
                pass
        return sorted(found)

    def fit(self):
        """Whether they have started, and what a script beside them does for them is done."""
        if "RIGEL_RMW_BESIDE" in os.environ:
            found = Progress.load()
            if found is None or found.step not in READY:
                return False
        return self.rates.met and rmw_notes.Notes.fit(self)

    def has_actions(self):
        """Whether a node offers an action."""
        ends = [one.name for one in self._entities() if one.kind == "service"]
        return any(name.endswith("/_action/send_goal") for name in ends)


class Names(threading.Thread):
    """Resolves a name, in a thread of its own since that may take long.

    Attributes:
        pause: seconds between two answers.
        addresses: the last answer; None before the first one. error: why there is none.
    """

    def __init__(self, name):
        threading.Thread.__init__(self, daemon=True)
        self.pause, self.addresses, self.error = 0.2, None, "no answer"
        self.name_to_find = name.encode()  # Python loads tables of Unicode to resolve a str
        self.news, self._wake = os.pipe()

    def run(self):
        """Resolve for ever."""
        while True:
            try:
                found = socket.getaddrinfo(self.name_to_find, None, type=socket.SOCK_STREAM)
                self.addresses, self.error = sorted({one[4][0] for one in found}), ""
            except socket.gaierror as error:
                if error.errno in (socket.EAI_NONAME, getattr(socket, "EAI_NODATA", -5)):
                    self.addresses, self.error = [], ""
                else:
                    self.error = str(error.strerror)
            os.write(self._wake, b"1")
            time.sleep(self.pause)


class Link(object):
    """A connection: to an endpoint that was tried, or, without one, from another program."""

    def __init__(self, sock, now, endpoint=None):
        self.sock, self.endpoint, self.since = sock, endpoint, now
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # messages of a switch are short
        self.connecting = endpoint is not None
        if not self.connecting:
            self.connected(now)
        self.greeted = self.known = False  # whether something has come, and from a keeper
        self.inbox, self.outbox = b"", b""

    def connected(self, now):
        """The connection is there."""
        self.connecting, self.since = False, now
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in CUT:
            self.sock.setsockopt(socket.IPPROTO_TCP, option, value)


class Keeper(object):
    """The loop: what arrives goes to the protocol, what that says is sent."""

    def __init__(self, environ):
        self.directory = environ["RIGEL_RMW"]
        self.first = int(environ.get("RIGEL_K8S_PEERS_PORT") or PORT)
        name, now, kept = environ.get("RIGEL_K8S_PEERS"), time.monotonic(), load(self.directory)
        self.born, term = min(float(kept.get("born", now)), now), int(kept.get("term", 0))
        self.reported, self.ends, self.gone = None, False, None
        identity = handover.Identity(
            environ.get("RIGEL_K8S_WORKLOAD", ""),
            environ.get("RIGEL_K8S_POD") or socket.gethostname(),
            "%d.%.6f" % (os.getpid(), now),
            self.born,
        )
        above, own = os.path.split(self.directory)
        together = environ.get("RIGEL_K8S_TOGETHER", own).split(":")
        others = [os.path.join(above, one) for one in together if one != own]
        limits = rates.parse(environ.get("RIGEL_K8S_RATES", ""))
        side = Side(self.directory, handover.WAIT if name else handover.WORK, others, limits)
        self.rates = side.rates
        drain = float(environ.get("RIGEL_K8S_DRAIN") or 300)
        self.protocol = handover.Handover(identity, side, self._save, self._report, drain, term)
        self._save(term)
        if os.path.exists(self._path(LEAVES)):
            os.unlink(self._path(LEAVES))
        self.links, self.avoided, self.asked, self.poll = {}, {}, None, select.poll()
        self.listener = self._listen()
        self.begun = self.moved = self.next_try = now
        self.names, self.settled, self.tried = Names(name) if name else None, not name, None
        self.patience, self.doubted = BRIEF if term else PATIENCE, 0.0
        self.protocol.start(now, works=side.mode == handover.WORK)
        if self.names is None:
            self.protocol.looked(now)
        else:
            self.poll.register(self.names.news, select.POLLIN)
            self.names.start()
        self.signals, wake = os.pipe()
        os.set_blocking(wake, False)
        self.poll.register(self.signals, select.POLLIN)

        def handle(number, _):
            self.ends = self.ends or number != signal.SIGUSR1
            os.write(wake, b"1")

        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, handle)

    def _listen(self):
        for port in range(self.first, self.first + PORTS):
            for family, any_address in ((socket.AF_INET6, "::"), (socket.AF_INET, "")):
                try:
                    listener = socket.socket(family, socket.SOCK_STREAM)
                except OSError:  # no IPv6
                    continue
                try:
                    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    if family == socket.AF_INET6:
                        listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
                    listener.bind((any_address, port))
                    listener.listen(LINKS)
                except OSError:
                    listener.close()
                    continue
                listener.setblocking(False)
                self.poll.register(listener, select.POLLIN)
                return listener
        sys.stdout.write("[rigel-k8s] no free port from %d to %d\n" % (self.first, port))
        sys.stdout.flush()
        return None

    # ---- What outlasts a run -------------------------------------------------------------------

    def _path(self, name):
        return os.path.join(self.directory, name)

    def _save(self, term):
        write(self._path(KEPT), {"born": self.born, "term": term, "pid": os.getpid()})

    def _report(self, step, line):
        if (step, line) != self.reported:
            self.reported = step, line
            progress = Progress(step, line, "", os.getpid(), [self._path(PROGRESS)])
            if step == "starts" or line == "works":  # nothing that someone has to read
                progress.save()
            else:
                progress.report()

    # ---- The loop ------------------------------------------------------------------------------

    def run(self):
        """Work until a signal comes."""
        wait = 0.0
        while not self.ends:
            for fd, events in self.poll.poll(int(wait * 1000 + 0.999)):
                now = time.monotonic()
                if self.listener is not None and fd == self.listener.fileno():
                    self._accept(now)
                elif fd in self.links:
                    self._serve(now, self.links[fd], events)
                else:  # a signal, or an answer of the name service
                    os.read(fd, 4096)
            now = time.monotonic()
            if self.ends:
                self.protocol.leave(now, 0.0)
            wait = max(0.0, min(self._look(now), self._turn(now)))
        for link in list(self.links.values()):  # goodbye must arrive before the end does
            link.sock.settimeout(0.2)
            try:
                link.sock.sendall(link.outbox)
            except OSError:
                pass

    def _turn(self, now):
        """Let the protocol do what is due, and send what it says; return when it is due again."""
        protocol, leaves = self.protocol, self._path(LEAVES)
        asked = os.path.exists(leaves)
        if asked and protocol.role != handover.LEFT:
            protocol.leave(now, float(read(leaves).get("seconds", 0)))
        if now >= self.rates.due:
            self.rates.look(now)
        met = len(protocol.peers)
        wait = protocol.tick(now)
        box, protocol.outbox = protocol.outbox, []
        for link, message in box:
            if message is None:
                if link.endpoint and not link.known:
                    self.avoided[link.endpoint] = now + AVOID
                self._close(now, link)
            elif link in self.links.values():
                link.outbox += json.dumps(message).encode() + b"\n"
                self._send(now, link)
        if len(protocol.peers) < met:  # it may be there again
            self.moved = self.next_try = now
        if asked and protocol.role == handover.LEFT:
            self._conclude(now)
        if self.asked and not protocol.hurries:
            self._answer(now)
        return min(wait, self.rates.due - now)

    def _conclude(self, now):
        """Say whether another pod works instead of this one, as soon as that is certain."""
        self.gone = self.gone or now
        peers = self.protocol.peers.values()
        works = any(peer.works for peer in peers)
        if works or now >= self.gone + SUCCEED or not any(peer.alive for peer in peers):
            write(self._path(LEFT), {"works": works})
            os.unlink(self._path(LEAVES))

    def _look(self, now):
        """Connect to other pods; return when that is due again."""
        for link in list(self.links.values()):
            limit = CONNECTING if link.connecting else GREETING
            if not link.known and now - link.since >= limit:
                self._close(now, link)
        names = self.names
        if names is None:
            return GREETING
        if now >= self.next_try or names.addresses != self.tried:
            late = RARELY if self.protocol.role == handover.WORKS else TRIES[-1][1]
            pauses = [pause for seconds, pause in TRIES if now < self.moved + seconds]
            names.pause = (pauses + [late])[0]
            self.next_try = now + names.pause
            self._try(now)
        if not self.settled:
            problem = ""
            if self.tried is None:  # names.addresses may have come just now, and is not tried yet
                problem = "the name service did not name the other pods: " + names.error
                self.settled = now - self.begun >= self.patience
                if now - self.begun >= BRIEF and self.protocol.role == handover.LOOKS:
                    self._report("starts", problem)
            else:
                known = all(link.known for link in self.links.values() if link.endpoint)
                limit = min(self.doubted + GREETING, self.begun + PATIENCE)
                self.settled = known and now >= limit
            if self.settled:
                self.protocol.looked(now, problem)
        return self.next_try - now

    def _try(self, now):
        self.tried = self.names.addresses
        if self.tried is not None:  # a pod that has gone does not refuse: it is silent
            for link in [one for one in self.links.values() if one.connecting]:
                if link.endpoint[0] not in self.tried:
                    self._close(now, link)
        busy = {link.endpoint for link in self.links.values()}
        self.avoided = {place: end for place, end in self.avoided.items() if end > now}
        for address in self.tried or []:
            for place in ((address, port) for port in range(self.first, self.first + PORTS)):
                if place in busy or place in self.avoided or len(self.links) >= 4 * LINKS:
                    continue
                family = socket.AF_INET6 if ":" in address else socket.AF_INET
                link = Link(socket.socket(family, socket.SOCK_STREAM), now, place)
                if link.sock.connect_ex(place) in (0, errno.EINPROGRESS):
                    self.links[link.sock.fileno()] = link
                    self.poll.register(link.sock, select.POLLOUT)
                else:
                    link.sock.close()

    def _accept(self, now):
        try:
            sock, _ = self.listener.accept()
        except OSError:
            return
        strangers = [link for link in self.links.values() if not link.known and not link.endpoint]
        if len(strangers) >= LINKS:  # they cannot keep others out
            self._close(now, min(strangers, key=lambda link: link.since))
        self.links[sock.fileno()] = Link(sock, now)
        self.poll.register(sock, select.POLLIN)

    def _serve(self, now, link, events):
        """Send and receive what is due on a connection."""
        if link.connecting:
            if link.sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._close(now, link)
                return
            link.connected(now)
            self.protocol.opened(now, link)
            self._send(now, link)
        elif events & select.POLLOUT:
            self._send(now, link)
        if link.sock.fileno() < 0 or not events & ~select.POLLOUT:
            return
        try:
            text = link.sock.recv(1 << 18)
        except BlockingIOError:
            return
        except OSError as error:
            self._close(now, link, error)
            return
        link.inbox += text
        if not text or not self._read(now, link) or len(link.inbox) > self._limit(link):
            self._close(now, link)

    @staticmethod
    def _limit(link):
        return AFTER if link.known else BEFORE

    def _read(self, now, link):
        """Hand whole messages to the protocol; return False for what is not one."""
        if not link.endpoint and not link.known and link.inbox.startswith(b"GET "):
            if b"\r\n\r\n" in link.inbox:
                if not link.inbox.startswith(b"GET /notes ") or self.asked:
                    return False
                self.asked = link
            return True
        while b"\n" in link.inbox:
            line, _, rest = link.inbox.partition(b"\n")
            try:
                message = json.loads(line.decode(), parse_int=_number, parse_constant=_number)
            except (ValueError, RecursionError):
                return False
            if len(line) > self._limit(link):
                return False
            link.inbox = rest
            if not link.endpoint and not link.greeted:
                self.protocol.opened(now, link)  # a stranger speaks first
            link.greeted = True
            self.protocol.received(now, link, message)
            link.known = self.protocol.knows(link)
        return True

    def _send(self, now, link):
        try:
            if link.outbox and not link.connecting:
                link.outbox = link.outbox[link.sock.send(link.outbox) :]
        except BlockingIOError:
            pass
        except OSError as error:
            self._close(now, link, error)
            return
        if len(link.outbox) > AFTER:
            self._close(now, link)
            return
        out = select.POLLOUT if link.outbox or link.connecting else 0
        self.poll.modify(link.sock, out if link.connecting else out | select.POLLIN)

    def _close(self, now, link, error=None):
        if self.links.get(link.sock.fileno()) is not link:
            return
        del self.links[link.sock.fileno()]
        if link.endpoint and not (link.connecting or link.known or link.endpoint in self.avoided):
            self.doubted = now  # it may be a keeper that gets no processor time
        self.poll.unregister(link.sock)
        link.sock.close()
        if self.asked is link:
            self.asked = None
        silent = error is not None and error.errno in (errno.ETIMEDOUT, errno.EHOSTUNREACH)
        self.protocol.closed(now, link, "does not answer" if silent else "ended")

    def _answer(self, now):
        """Answer `GET /notes`, once no switch is in a hurry."""
        link, self.asked = self.asked, None
        text = json.dumps(rmw_notes.describe(self.directory)).encode()
        head = "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: %d\r\n"
        link.outbox = (head % len(text)).encode() + b"Connection: close\r\n\r\n" + text
        link.inbox, link.since = b"", now
        self._send(now, link)


def _number(text):
    if len(text) > 20 or text[-1:].isalpha():  # NaN, Infinity
        raise ValueError(text)
    return int(text)


def read(path):
    """Return a file's JSON object, an empty one if there is none."""
    try:
        with open(path) as opened:
            found = json.load(opened)
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def write(path, value):
    """Write a file of JSON, all or nothing."""
    with open(path + ".new", "w") as opened:
        json.dump(value, opened)
    os.rename(path + ".new", path)


def load(directory):
    """Return what a keeper's earlier run has kept."""
    return read(os.path.join(directory, KEPT))


def leave(directory, seconds):
    """Let the keeper hand over or say goodbye; return whether another pod works then."""
    path, pid = os.path.join(directory, LEAVES), load(directory).get("pid", 0)
    end = time.monotonic() + seconds + SUCCEED + 1.0
    if not pid or not os.path.isdir("/proc/%d" % pid):
        return False
    write(path, {"seconds": seconds})
    os.kill(pid, signal.SIGUSR1)
    while os.path.exists(path) and os.path.isdir("/proc/%d" % pid):
        if time.monotonic() >= end:
            return False
        time.sleep(0.02)
    return bool(read(os.path.join(directory, LEFT)).get("works"))


def main(arguments, environ):
    """Run a command; return the exit code."""
    directory = environ["RIGEL_RMW"]
    if arguments == ["run"]:
        try:
            keeper = Keeper(environ)
        except rmw_notes.OtherVersion:  # to start again would not help
            with open(os.path.join(directory, LEFT_OUT), "w") as opened:
                opened.write(OTHER + "\n")
            sys.stdout.write("[rigel-k8s] it cannot be handed over: %s\n" % OTHER)
            return 0
        keeper.run()
        return 0
    if arguments[:2] == ["leave", "--wait"] and len(arguments) == 3:
        return 0 if leave(directory, float(arguments[2])) else 1
    if arguments == ["state"]:
        found = Progress.load([os.path.join(directory, PROGRESS)])
        print(found.line if found else "has not started yet")
        return 0 if found and found.step == "works" else 1
    sys.stderr.write(__doc__)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], os.environ))
