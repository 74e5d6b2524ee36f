"""Is the ROS 2 node itself ready? What the layer has noted of its processes, for the probe.

Why: that a process takes part in DDS says nothing of its node, which may not exist yet, or whose
callback never returns. The layer (rigel_rmw) notes both inside of the process. And a pod that waits
to take over from another one must not be ready, since Kubernetes would end that one.

    rmw_ready.py stuck SECONDS [TOPIC=SECONDS...]   the liveness probe: an executor has stood still
                                    for so long, or a participant has not read what it is sent (0:
                                    not asked); or a topic that was published is silent

Contract: exit code 1 if so, else 0, also without the layer; 2 for wrong arguments; one line on
standard output. It must run regularly: what waits to be read is compared with the run before, in a
file beside the notes. dds_ready.py has the contract of the readiness probe, which calls `look`.
Python 3.6 and newer, nothing but the standard library.
"""

import os
import sys
import time

import dds_local
import progress
import rmw_notes

STILL = 30.0  # seconds without any sign of life after which a process hangs
PROGRESS, STANDBY = "progress", "standby"  # the keeper's file, and its step while it waits
WAITS = "waits"  # the kind of that cause, for `rigel run`
UNREAD = "unread"  # its lines: the inode of a participant's socket, since when it is not read


class NotReady(Exception):
    """The message is the cause, in one line."""


def look(directory, node, hands_over):
    """Return what is ready, in lines; raise NotReady otherwise.

    Args:
        node: the full ROS name of the node that must exist, None if its name is not known.
        hands_over: the pod waits for its turn.
    """
    left_out = find_left_out(directory)
    if left_out:
        if hands_over:
            raise NotReady("it cannot be handed over: %s" % left_out)
        return []
    own = [p for p in rmw_notes.read_all(directory) if not (p.ended or p.helper)]
    if not own and rmw_notes.find_other_versions(directory):  # these scripts came after the pod
        if hands_over:
            check_turn(directory)
        return []
    if not own and not hands_over:
        return []  # a program without ROS 2's middleware: it is probed as before
    names = [e.name for process in own for e in process.entities if e.kind == "node"]
    if node and node not in names:
        other = "; there is %s, does it read --ros-args?" % names[0] if names else ""
        if not own:
            other = ": no process has loaded ROS 2; a program without it needs `ros: none`"
        raise NotReady("the node %s does not exist yet%s" % (node, other))
    if not names and hands_over:
        text = "no ROS 2 node exists yet: a program without ROS cannot be handed over (`ros: none`)"
        raise NotReady(text)
    for process in own:
        check_turns(process)
    if os.environ.get("RIGEL_K8S_RATES"):
        import rates  # other nodes do not need it

        slow = rates.explain(directory, rates.parse(os.environ["RIGEL_K8S_RATES"]))
        if slow:
            raise NotReady(slow)
    if hands_over:  # last: what is wrong with the node is why it does not get its turn
        check_turn(directory)
    return names


def find_left_out(directory):
    """Return why the program runs without the layer, "" if it runs with it."""
    if not os.path.isdir(directory):
        return "%s cannot be written" % directory
    try:
        with open(os.path.join(directory, "left-out")) as file:
            return file.read().strip()
    except (IOError, OSError):
        return ""


def check_turn(directory):
    """Check that this pod works."""
    files = [os.path.join(directory, PROGRESS)]
    ready, line = progress.describe("keeper.py", "this pod", files)
    found = progress.Progress.load(files)
    if not ready:
        raise NotReady(line + (" [%s]" % WAITS if found and found.step == STANDBY else ""))


def check_turns(process):
    """Check that a process does something, or waits for something to do."""
    last = max(e.last for e in process.entities) if process.stands else 0
    still = min(process.stands, rmw_notes.now() - last) / 1e9  # its own threads may do something
    if still > STILL:
        text = "%s hangs: no turn of its executor for %.0f s"
        raise NotReady(text % (name_first(process), still))


def name_first(process):
    """Return the name of a process, which is that of its first node."""
    names = [e.name for e in process.entities if e.kind == "node"]
    return names[0] if names else "process %d" % process.pid


def main(words):
    """Run the liveness probe and return its exit code."""
    try:
        longest = float(words[1]) or float("inf")
        limits = {name: float(text) for name, text in (word.split("=") for word in words[2:])}
    except (IndexError, ValueError):
        limits = None
    if limits is None or words[0] != "stuck":
        sys.stdout.write("wrong arguments: stuck SECONDS [TOPIC=SECONDS...]\n")
        return 2
    directory, lines = os.environ.get("RIGEL_RMW", ""), []
    if os.path.isdir(directory):
        found = list(find_still(directory)) + list(find_deaf(directory))
        lines = [line for seconds, line in found if seconds >= longest]
        lines += find_silent(directory, limits)
    sys.stdout.write("%s\n" % (lines[0] if lines else "no executor stands still"))
    return 1 if lines else 0


def find_silent(directory, limits):
    """Yield a line for each publisher that has published, and nothing since.

    One that has never published is a matter of readiness, and one of a pod that waits, or that was
    replaced, is meant to be silent.

    Args:
        limits: seconds, by topic.
    """
    for process in rmw_notes.read_all(directory):
        if process.ended or process.helper or process.mode != rmw_notes.WORK:
            continue
        for one in process.entities:
            if one.kind != "publisher" or one.name not in limits or not one.last:
                continue
            silent = (rmw_notes.now() - one.last) / 1e9
            if silent > limits[one.name]:
                yield "%s has published nothing on %s for %.1f s" % (one.node, one.name, silent)


def find_still(directory):
    """Yield for how many seconds an executor stands still, with a line that names it."""
    for process in rmw_notes.read_all(directory):
        if not (process.ended or process.helper):
            still = process.stands / 1e9
            yield still, "%s: no turn of its executor for %.0f s" % (name_first(process), still)


def find_deaf(directory):
    """Yield for how many seconds a participant has read nothing of what it is sent, with a line.

    Fast DDS is known to stop so, for good, when other participants end.
    """
    path, noted, now = os.path.join(directory, UNREAD), {}, time.monotonic()
    try:
        with open(path) as file:
            before = dict(line.split() for line in file)
    except (IOError, OSError, ValueError):
        before = {}
    for process in dds_local.residents():
        for one in (s for s in process.find_unicast() if s.waiting):
            if not dds_local.is_read(one.inode, seconds=1.0):
                noted[one.inode] = since = before.get(one.inode, "%.1f" % now)
                seconds = now - float(since)
                text = "%s has not read its UDP port %d for %.0f s"
                yield seconds, text % (process, one.port, seconds)
    if noted != before:
        with open(path, "w") as file:
            file.writelines("%s %s\n" % one for one in sorted(noted.items()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
