"""Does this pod's part of the ROS 1 graph work? One line and an exit code.

Why: a pod that is "Running" may be deaf. A node counts if the master has it at this pod's address
and it answers. That fails when the node hangs, when its name was taken by another pod, and when the
master has restarted empty (nothing in ROS 1 registers a node again).

    ready.py node [--wait SECONDS] [--components /ros/name]
    ready.py master [--wait SECONDS]

Contract: exit code 0 ready, 1 not ready, 2 wrong arguments; one line on standard output has the
cause: the kubelet makes it the probe event's message. --wait tries again until ready or SECONDS are
over, so that a start is noticed at once without a process for each look. --components: all nodelets
of this manager must also be loaded (nodelets.py).

    ready.py leave [--wait SECONDS]

asks the gate in front of the master (rigel_gate) to give the names of this pod's nodes to those
that wait for them, and gives these SECONDS to become ready; 1 if it gave none.

Environment: ROS_MASTER_URI, ROS_IP, ROS_HOSTNAME; RIGEL_K8S_WORKLOAD is the workload of a pod whose
nodes hand their names over. Python 2.7 and 3, nothing but the standard library.
"""

import os
import sys
import time

try:
    from _thread import start_new_thread
except ImportError:  # Python 2
    from thread import start_new_thread

from container import Listeners, command, processes
from memory import Memory, Node
from rosrpc import Api, CallFailed, split

LOOK = 15.0  # seconds for one look: less than the kubelet gives a probe
MASTER = 8.0  # seconds that the master has for all its answers in a look, on a busy machine too
ANSWER = 8.0  # seconds that a node has to answer; two such looks take less than 30 s
TICK = 0.2  # seconds between two looks while waiting
CALM = 10  # looks after which a tick gets five times as long: all pods ask one master
FRESH = 2.0  # seconds that "this name belongs to another pod" is believed
ROSVERSION = "/rosversion"  # a parameter that roscore sets after its master has started
ROSOUT = "/rosout"  # belongs to a roscore; where an image starts one itself it makes nothing ready
SEARCHES = 3  # times that the master is searched for the nodes of one process


class NotReady(Exception):
    """The message is the cause, in one line."""


class Look(object):
    """One look at this pod's nodes: the local sockets, the master, then the nodes themselves."""

    def __init__(self, master_uri, elsewhere):
        """`elsewhere` is kept between looks (FRESH)."""
        self.elsewhere = elsewhere
        self.until = time.time() + LOOK
        self.ports = Listeners().pids
        self.memory = Memory()
        self.master = Api(master_uri, time.time() + MASTER)

    def run(self):
        """Return the names of the pod's nodes, all working; raise NotReady otherwise."""
        if not self.ports:
            raise NotReady("no process of this container listens yet, so no ROS node has started")
        waiting = self._waiting()
        known = dict(i for i in self.memory.nodes.items() if i[0] not in waiting)
        nodes = self._confirm(known)
        nodes.update(waiting)
        if not nodes or self._newcomers(nodes):
            nodes.update(self._search(nodes))
        if not nodes:
            raise NotReady(self._describe_missing())
        self.memory.nodes = nodes
        self.memory.save()
        for node in nodes.values():
            self._answers(node)
        state = dict.fromkeys(waiting, " waits to take over")
        return [name + state.get(name, "") for name in sorted(nodes)]

    def _ask(self, method, *arguments):
        """Return the master's value for a call; None if the master has none."""
        try:
            code, _, value = self.master.call(method, *arguments)
        except CallFailed as error:
            known = ", ".join(sorted(self.memory.nodes)) or "none registered so far"
            text = "the ROS master at %s cannot be reached: %s (nodes of this pod: %s)"
            raise NotReady(text % (self.master.uri, error, known))
        return value if code == "1" else None

    def _waiting(self):
        """Return the pod's nodes that wait for a name that the previous pod has."""
        workload = os.environ.get("RIGEL_K8S_WORKLOAD")
        if not workload:
            return {}
        own = (os.uname()[1], workload, advertised())
        try:
            answer = self.master.call("rigelDescribePod", *own)[2]
        except CallFailed:
            return {}  # no gate, or no master: the next request finds out
        busy = [name for name, uri, state, _ in answer if state == "busy" and self._here(uri)]
        if busy:
            raise NotReady("%s still registers; it waits to take over" % busy[0])
        return {name: self._node(name, uri) for name, uri, _, _ in answer if self._here(uri)}

    def _answers(self, node):
        deadline = min(self.until, time.time() + ANSWER)
        started = time.time()
        try:
            Api(node.uri, deadline).call("getPid")
        except CallFailed as error:
            text = "%s is registered but does not answer: %s after %.1f s"
            raise NotReady(text % (node, error, time.time() - started))

    # -- nodes that an earlier look found --

    def _confirm(self, known):
        """Return those of the known nodes that continue: registered from here, process alive."""
        found = [self._confirm_node(node) for node in known.values()]
        nodes = {node.name: node for node in found if node}
        run = self._ask("getParam", "/run_id") if nodes else None
        if nodes and (run or "") != self.memory.run:
            self._complete(nodes)
            self.memory.run = run or ""
        return nodes

    def _confirm_node(self, node):
        """Return the node as it is now, None if it has ended in order."""
        uri, alive = self._ask("lookupNode", node.name), self._here(node.uri)
        if uri == node.uri and not alive:
            if not self._is_listed(node.name):  # it has unregistered, as after `rosnode kill`
                return None
            raise NotReady("%s has crashed: it is registered, but its process has ended" % node)
        if uri and self._here(uri):  # the same, or started again by a shell or by roslaunch
            return self._node(node.name, uri)
        if alive and uri:
            text = "%s has lost its name to another node: the ROS master has it at %s"
            raise NotReady(text % (node, uri))
        if alive:
            raise NotReady(self._orphan(node, "does not have it"))
        return None

    def _is_listed(self, name):
        """Return whether a node has any topic or service at the master.

        `lookupNode` still returns the name of a node that has unregistered but had subscribed to a
        parameter.
        """
        state = self._ask("getSystemState") or [[], [], []]
        return any(name in names for part in state for _, names in part)

    def _complete(self, nodes):
        """Check, after a restart of the master, that it has all registrations of the nodes."""
        state = self._ask("getSystemState") or [[], [], []]
        for part, method in ((0, "getPublications"), (1, "getSubscriptions")):
            for node in nodes.values():
                has = {topic for topic, names in state[part] if node.name in names}
                missing = sorted(self._topics(node, method) - has)
                if missing:
                    raise NotReady(self._orphan(node, "does not have its " + missing[0]))

    def _topics(self, node, method):
        """Return the topics that the node itself reports to publish or subscribe."""
        try:
            code, _, value = Api(node.uri, self.until).call(method)
        except CallFailed:
            return set()  # _answers reports it
        return {entry[0] for entry in value} if code == "1" else set()

    def _orphan(self, node, what):
        text = (
            "%s is an orphan: the ROS master at %s has restarted and %s; restart this pod [orphan]"
        )
        return text % (node, self.master.uri, what)

    # -- nodes that are not found yet --

    def _newcomers(self, nodes):
        """Return whether the master was searched too few times for some process."""
        pids = set(self.ports.values()) - {node.pid for node in nodes.values()}
        return any(self.memory.searched.get(pid, 0) < SEARCHES for pid in pids if pid)

    def _search(self, nodes):
        """Return the further nodes that the master has at this pod's address, by name."""
        found, left = {}, set(self.ports.values()) - {node.pid for node in nodes.values()}
        for name in self._candidates():
            if not left:
                break
            uri = self._ask("lookupNode", name)
            if uri and self._here(uri):
                found[name] = self._node(name, uri)
                left.discard(found[name].pid)
            else:
                self.elsewhere[name] = time.time()
        for pid in left:
            self.memory.searched[pid] = self.memory.searched.get(pid, 0) + 1
        if found and not nodes:
            self.memory.run = self._ask("getParam", "/run_id") or ""
        return found

    def _candidates(self):
        """Return the names that may be this pod's, the latest to register first."""
        state = self._ask("getSystemState") or [[], [], []]
        entries = [entry for part in state for entry in part]
        names = []  # each registers /rosout early
        for _, entry in sorted(entries, key=lambda e: e[0] != ROSOUT):
            names += reversed(entry)
        age = {name: index for index, name in reversed(list(enumerate(names)))}
        return [
            name
            for name in sorted(age, key=age.get)
            if name != ROSOUT and time.time() - self.elsewhere.get(name, 0) > FRESH
        ]

    def _describe_missing(self):
        pids = sorted({pid for pid in self.ports.values() if pid})
        here = "; ".join("%d %s" % (pid, command(pid)) for pid in pids[:3]) or "another user's"
        text = "no ROS node of this pod is registered at %s with the ROS master at %s"
        text += " (processes that listen here: %s)"
        return text % (self._addresses()[0], self.master.uri, here)

    # -- what is this pod's --

    def _node(self, name, uri):
        return Node(name, uri, self.ports.get(split(uri)[1]))

    def _here(self, uri):
        try:
            host, port = split(uri)
        except CallFailed:
            return False
        return port in self.ports and host in self._addresses()

    def _addresses(self):
        named = [os.environ.get("ROS_HOSTNAME"), os.environ.get("ROS_IP")]
        named += [self.master.local_address(), os.uname()[1], "localhost", "127.0.0.1", "::1"]
        return [name for name in named if name]


def advertised():
    """Return the address that this pod's nodes advertise."""
    named = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP")
    return named or os.uname()[1]


def leave(seconds):
    """Return (exit code, line) for a pod that has handed over what others wait for."""
    uri = os.environ.get("ROS_MASTER_URI", "")
    try:
        master = Api(uri, time.time() + seconds + ANSWER)
        names = master.call("rigelHandOver", str(seconds), advertised())[2]
    except CallFailed as error:
        return 1, "nothing is handed over: %s" % error
    return (0, "handed over: " + ", ".join(names)) if names else (1, "no one waits")


def look_node(elsewhere, manager=None):
    """Return the line for a pod whose nodes are in order; raise NotReady otherwise.

    The nodelets of a `manager` must be loaded, too.
    """
    uri = os.environ.get("ROS_MASTER_URI")
    if not uri:
        raise NotReady("ROS_MASTER_URI is not set in this container")
    try:
        lines = Look(uri, elsewhere).run()
    except CallFailed as error:
        raise NotReady("ROS_MASTER_URI: %s" % error)
    if manager:
        from progress import describe  # other nodes do not need it

        are_loaded, line = describe("nodelets.py", manager)
        if not are_loaded:
            raise NotReady(line)
        lines.append(line)
    return "ready: " + ", ".join(lines)


def look_master(starting):
    """Return the line for a master that answers; raise NotReady otherwise.

    A master that is `starting` must have the parameters that roscore sets shortly after: a node
    that reads /rosversion as soon as the master answers would fail. A rosmaster alone sets none.
    """
    try:
        port = split(os.environ.get("ROS_MASTER_URI", "http://localhost:11311"))[1]
        master = Api("http://127.0.0.1:%d" % port, time.time() + ANSWER)
        master.call("getPid")
        if starting and roscore_runs() and master.call("hasParam", ROSVERSION)[2] != "1":
            raise NotReady("roscore has not set %s yet" % ROSVERSION)
    except CallFailed as error:
        raise NotReady("the ROS master of this pod does not answer: %s" % error)
    return "ready: ROS master at port %d" % port


def roscore_runs():
    """Return whether a process of this container is roscore, not a rosmaster alone."""
    words = [word for pid in processes() for word in command(pid).split()]
    return any(word.rpartition("/")[2] == "roscore" for word in words)


def watch(limit, last):
    """End the process with a message when a look hangs in a call without a deadline (DNS)."""
    time.sleep(limit)
    hanging = "timed out after %.1f s; is the cluster's DNS in order?" % limit
    finish(1, last[0] if last else hanging)


def finish(code, line):
    """Print the line and end, even if other threads still run."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
    os._exit(code)


def arguments(words):
    """Return (kind, seconds to wait, a manager of nodelets or None); raise ValueError else."""
    kind, words = words[0] if words else "", words[1:]
    values = dict(zip(words[::2], words[1::2]))
    known = {"node": {"--wait", "--components"}, "master": {"--wait"}, "leave": {"--wait"}}
    if kind not in known or len(words) % 2 or set(values) - known[kind]:
        raise ValueError("node|master|leave [--wait SECONDS] [--components /NODE]")
    return kind, float(values.get("--wait", 0)), values.get("--components")


def main(words):
    """Look until ready or the time is over; never returns."""
    try:
        kind, wait, manager = arguments(words)
    except ValueError as error:
        finish(2, "ready.py: %s" % error)
    end, last, elsewhere, looks = time.time() + wait, [], {}, 0
    start_new_thread(watch, (wait + LOOK + 0.3, last))
    if kind == "leave":
        finish(*leave(wait))
    while True:
        try:
            if kind == "node":
                finish(0, look_node(elsewhere, manager))
            finish(0, look_master(wait > 0))
        except NotReady as why:
            last[:] = [str(why)]
        looks += 1
        pause = TICK if looks <= CALM else 5 * TICK
        if time.time() + pause >= end:
            finish(1, last[0])
        time.sleep(pause)


if __name__ == "__main__":
    main(sys.argv[1:])
