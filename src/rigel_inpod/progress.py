"""What the script beside a node has reached, in a file that the readiness probe reads.

Why: a component that cannot be loaded, or a transition that fails, must be the cause that a user
sees, not a line of a log. A script that works beside a node (beside.sh) writes its steps here;
ready.py and dds_ready.py report them. Python 2.7 and 3, nothing but the standard library.
"""

import os
import sys
import time

import container

NAME = ".rigel-k8s-progress"
LOGS = "/rigel-k8s-logs"  # every pod of ROS 2 can write there
FILES = tuple(os.path.join(d, NAME) for d in (LOGS, os.environ.get("TMPDIR") or "/tmp", "/dev/shm"))

#: Steps that count as ready, and the one after which the script has ended.
READY = ("done", "works")
FINAL = ("done",)


class Progress(object):
    """What a script has reached.

    Attributes:
        step: starts, loads, activates, failed or done; a keeper's: starts, standby, works or left.
        line: the same as a sentence.
        token: what the script needs to read back.
        pid: the script's process.
        files: the first of them that can be written keeps it.
    """

    def __init__(self, step="", line="", token="", pid=0, files=None):
        self.step, self.line, self.token, self.pid, self.files = step, line, token, pid, files

    def report(self):
        """Save it and log it, unless it is the same as before."""
        last = Progress.load(self.files)
        if last is None or (last.step, last.line) != (self.step, plain(self.line)):
            self.save()
            sys.stdout.write("[rigel-k8s] %.3f %s\n" % (time.time(), plain(self.line)))
            sys.stdout.flush()

    def save(self):
        """Write it where this container can write."""
        words = (self.step, plain(self.line), self.token, self.pid)
        container.save_words(self.files or FILES, [words])

    @classmethod
    def load(cls, files=None):
        """Return what was written since the container started, None if nothing was."""
        for step, line, token, pid in container.load_words(files or FILES):
            return cls(step, line, token, int(pid))
        return None


def plain(text):
    """Return a text as one line of ASCII, which every container can write."""
    return str(" ".join(text.split()).encode("ascii", "replace").decode("ascii"))


def describe(script, name, files=None):
    """Return (whether the script has done what readiness waits for, its progress).

    Args:
        script: its file; name: the full ROS name of the node that it works for.
        files: where it keeps its progress, if not in FILES.
    """
    found = Progress.load(files)
    if found is None:
        return False, "%s has not started yet for %s" % (script, name)
    if found.step not in FINAL and not os.path.isdir("/proc/%d" % found.pid):
        return False, "%s has ended early for %s; see the log" % (script, name)
    return found.step in READY, found.line
