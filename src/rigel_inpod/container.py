"""What runs and listens in this container, from /proc; independent of ROS. Python 2.7 and 3.

Why: under host networking several pods share one address, so the address does not show whose node
it is; the listening process does. Processes of other containers (hostPID, a shared process
namespace) are left out by their cgroup.

What `kubectl exec` starts runs in the container without being part of it. A tool that someone runs
for a moment is not one of the pod's nodes, neither while it runs nor after it was killed.
"""

import os

PROC = "/proc"
GONE = (0, 0)
ESTABLISHED, LISTEN = "01", "0A"  # states of a socket in /proc/net/tcp
EXEC_MARK = b"RIGEL_K8S_EXEC=1"  # rc.sh sets it: it marks a tool left in the background


class Listeners(object):
    """The TCP ports on which the processes of this container's own command listen.

    Attributes:
        pids: port -> process id; None if the owner is not visible.
    """

    def __init__(self):
        """Read the sockets now."""
        inodes, visiting = _listening(), visitors()
        self.pids, visited = {}, set()
        hidden = False
        for pid in processes():
            try:
                ports = [inodes[inode] for inode in sockets(pid) if inode in inodes]
            except OSError:
                hidden = hidden or pid not in visiting
                continue
            if pid in visiting:
                visited.update(ports)
            else:
                self.pids.update((port, pid) for port in ports)
        if hidden:  # of another user: any port of this network namespace may be theirs
            for port in set(inodes.values()) - visited:
                self.pids.setdefault(port, None)


def processes():
    """Return the ids of this container's processes but this one."""
    own, me = _cgroup("self"), os.getpid()
    found = (int(name) for name in os.listdir(PROC) if name.isdigit())
    return [pid for pid in sorted(found) if pid != me and _cgroup(pid) == own]


def visitors():
    """Return the ids of those processes that the container's own command did not start.

    An exec'd process has no visible parent, like the container's command, and started later. What
    it leaves behind when it ends is the child of process 1 and carries EXEC_MARK. Where parents are
    no help (hostPID shows the runtime as the parent of all), only the mark helps.
    """
    found = {pid: _parent_and_start(pid) for pid in processes()}
    found = {pid: known for pid, known in found.items() if known != GONE}
    roots = {pid: _root(pid, found) for pid in found}
    first = min(set(roots.values()), key=lambda pid: (found[pid][1], pid)) if roots else None
    return {
        pid
        for pid, root in roots.items()
        if (root != first and found[root][0] == 0) or _is_marked(pid)
    }


def command(pid):
    """Return a process's arguments as one short line, "" if it has ended."""
    text = _read(PROC + "/%s/cmdline" % pid).replace(b"\0", b" ").decode("utf-8", "replace")
    return text.strip()[:80]


def started():
    """Return a mark of this container's present life: it differs after a restart."""
    return str(_parent_and_start(1)[1])


def load_words(paths):
    """Return the lines that `save_words` wrote since the container started, as lists of words."""
    for path in paths:
        lines = [line.split("\t") for line in _read(path).decode("utf-8", "replace").splitlines()]
        if lines[:1] == [[started()]]:
            return lines[1:]
    return []


def save_words(paths, lines):
    """Write lines of words to the first path where this container can write, all or nothing.

    Two probes may run at the same time. A container that can write nowhere keeps nothing.
    """
    text = "".join("\t".join(map(str, words)) + "\n" for words in [(started(),)] + lines)
    for path in paths:
        partial = "%s.%d" % (path, os.getpid())
        try:
            with open(partial, "w") as file:
                file.write(text)
            os.rename(partial, path)
            return
        except (IOError, OSError):
            continue


def _parent_and_start(pid):
    """Return (the parent's id, when the process started), or GONE."""
    fields = _read(PROC + "/%s/stat" % pid).rpartition(b")")[2].split()
    return (int(fields[1]), int(fields[19])) if fields else GONE


def _root(pid, found):
    """Return the oldest ancestor that is one of `found`, the process itself if it has none."""
    while found[pid][0] in found:
        pid = found[pid][0]
    return pid


def _is_marked(pid):
    return EXEC_MARK in _read(PROC + "/%s/environ" % pid).split(b"\0")


def _cgroup(pid):
    return _read(PROC + "/%s/cgroup" % pid)


def sockets(pid):
    """Return the inodes of a process's sockets; OSError if only another user may see them."""
    folder = PROC + "/%s/fd" % pid
    found = []
    for name in os.listdir(folder):
        try:
            target = os.readlink("%s/%s" % (folder, name))
        except OSError:
            continue  # closed meanwhile
        if target.startswith("socket:["):
            found.append(target[8:-1])
    return found


def _listening():
    """Return inode -> port of every listening TCP socket of the network namespace."""
    return {line[9]: port_of(line[1]) for line in tcp_sockets(LISTEN)}


def tcp_sockets(state):
    """Return the fields of every TCP socket of the network namespace in a state."""
    found = read_table("net/tcp") + read_table("net/tcp6")
    return [fields for fields in found if fields[3] == state]


def read_table(name):
    """Return the fields of each line of a table in /proc, without its head."""
    lines = _read("%s/%s" % (PROC, name)).decode("ascii").splitlines()[1:]
    return [line.split() for line in lines]


def port_of(address):
    """Return the port of an address in /proc's notation."""
    return int(address.rpartition(":")[2], 16)


def _read(path):
    try:
        with open(path, "rb") as file:
            return file.read()
    except (IOError, OSError):
        return b""
