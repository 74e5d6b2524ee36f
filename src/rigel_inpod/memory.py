"""What earlier probes of this container found; a file in $TMPDIR or /dev/shm. Python 2.7 and 3.

Why: only the master's whole state lists all nodes, and if each probe requested it, that would cost
a master of 100 nodes more than the nodes do. With the names at hand two short requests are enough.
"""

import os

import container

NAME = ".rigel-k8s-nodes"
FILES = tuple(os.path.join(d, NAME) for d in (os.environ.get("TMPDIR") or "/tmp", "/dev/shm"))


class Node(object):
    """A node of this pod: its name, its URI and the process behind it (None: unknown)."""

    def __init__(self, name, uri, pid):
        self.name, self.uri, self.pid = name, uri, pid

    def __str__(self):
        return "%s (%s)" % (self.name, self.uri.rstrip("/"))


class Memory(object):
    """Attributes:

    nodes: the pod's nodes by name.
    run: the master's /run_id when they were found, "" for none.
    searched: how often the master was searched for the nodes of a process, by process id.
    """

    def __init__(self):
        """Read what is kept; nothing if the container has restarted since."""
        self.run, self.nodes, self.searched = "", {}, {}
        for words in container.load_words(FILES):
            self._take(*words)

    def save(self):
        """Keep it for the next probe; a container without a writable place just requests more."""
        lines = [("run", self.run)]
        lines += [("node", n.name, n.uri, n.pid or 0) for n in self.nodes.values()]
        lines += [("searched", pid, times) for pid, times in self.searched.items()]
        container.save_words(FILES, lines)

    def _take(self, kind, *words):
        if kind == "run":
            self.run = words[0]
        elif kind == "node":
            name, uri, pid = words
            self.nodes[name] = Node(name, uri, int(pid) or None)
        elif kind == "searched":
            self.searched[int(words[0])] = int(words[1])
