"""What runs and listens in this container, from /proc; knows nothing of ROS. Python 2.7 and 3.

Why: under host networking several pods share one address, so an address alone does not tell whose
node it is; the listening process does. Processes of other containers (hostPID, a shared process
namespace) are left out by their cgroup.
"""

import os


class Listeners(object):
    """The TCP ports on which this container's processes listen.

    Attributes:
        pids: port -> process id; None where the owner could not be told.
    """

    def __init__(self):
        """Look now."""
        inodes = _listening()
        self.pids = {}
        hidden = False
        for pid in processes():
            try:
                held = sockets(pid)
            except OSError:
                hidden = True
                continue
            for inode in held:
                if inode in inodes:
                    self.pids[inodes[inode]] = pid
        if hidden:  # of another user: any port of this network namespace may be theirs
            for port in inodes.values():
                self.pids.setdefault(port, None)


def processes():
    """Return the ids of this container's processes but this one."""
    own, me = _cgroup("self"), os.getpid()
    found = (int(name) for name in os.listdir("/proc") if name.isdigit())
    return [pid for pid in sorted(found) if pid != me and _cgroup(pid) == own]


def command(pid):
    """Return a process's arguments as one short line, "" where it is gone."""
    text = _read("/proc/%s/cmdline" % pid).replace(b"\0", b" ").decode("utf-8", "replace")
    return text.strip()[:80]


def started():
    """Return a mark of this container's present life: another one after a restart."""
    return _read("/proc/1/stat").rpartition(b")")[2].split()[19].decode()


def _cgroup(pid):
    return _read("/proc/%s/cgroup" % pid)


def sockets(pid):
    """Return the inodes of a process's sockets; OSError where they are another user's to see."""
    folder = "/proc/%s/fd" % pid
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
    found = {}
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in _read(table).decode("ascii").splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A":
                found[fields[9]] = int(fields[1].rpartition(":")[2], 16)
    return found


def _read(path):
    try:
        with open(path, "rb") as file:
            return file.read()
    except (IOError, OSError):
        return b""
