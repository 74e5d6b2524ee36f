"""record.py FOLDER run SPLIT LIMIT [--on=FAULTS@EXPORTER] [TOPIC...] | list | delete NAME...

Why: ROS' recorders do not limit what all bags together take, do not repair what a lost power has
left, and leave it to the kernel when what they write reaches the disk.
Contract: README.md beside it. Python 2.7 and 3.6. Bags are in FOLDER. `run` starts the image's own
recorder for TOPICs, for all without one, and ends it by SIGINT when it gets SIGINT or SIGTERM.
SPLIT is how long a bag may be (300s), or how many bytes it may have; LIMIT is in bytes. With
FAULTS, as in breach,crash, only bags around those are kept. READY exists while a bag is
being written. `list` prints JSON. `delete` deletes all or nothing: 1 if a bag is being written or
does not exist.
"""

from __future__ import print_function

import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import time

import blackbox

READY = "/tmp/rigel-k8s-recording"
#: Bytes without which the disk is full: a recorder needs some to close its bag.
SPARE = 64 * 2**20
#: Seconds between two looks at the folder: a lost power costs what is written meanwhile.
LOOK = 1.0
#: Seconds until this process, too, gets the signal by which stop.sh has ended the recorder.
PATIENCE = 3.0
STAMP = "%Y-%m-%d-%H-%M-%S"
#: A bag's states. An unclosed one is not written any more, and not closed or repaired yet.
RECORDING, UNCLOSED, CLOSED = "recording", "unclosed", "closed"
REPAIRED, DAMAGED = "repaired", "damaged"
#: States that a bag has in its name; the faults are those for which it is kept.
MARKS = [REPAIRED, DAMAGED] + sorted(blackbox.METRICS)
METADATA = "metadata.yaml"
MISSING = "[rigel-k8s] the image has no %s, which records bags: install %s, or set `record.image`"
FULL = "[rigel-k8s] the disk of %s is full (%d MiB left): nothing is recorded until there is room"
#: ROS 2: the last chunk of a bag is lost with the power, so it is small.
MCAP = "chunkSize: 65536\n"
#: ROS 1: repairs a bag in its place, since `rosbag reindex` would need twice its size.
REINDEX = """
import sys, rosbag
bag = rosbag.Bag(sys.argv[1], "a", allow_unindexed=True)
for _ in bag.reindex():
    pass
bag.close()
"""


class Bag(object):
    """One bag.

    Attributes:
        name: what users call it; path: its file in ROS 1, its folder in ROS 2.
        started, ended: seconds since 1970; None if the start is not known.
    """

    def __init__(self, name, path, files, state, started):
        self.name, self.path, self.files, self.started = name, path, files, started
        marked = re.search("-(%s)(?=$|\\.bag$)" % "|".join(MARKS), name)
        self.state = marked.group(1) if marked else state
        self.size = sum(size_of(one) for one in files)
        self.ended = max([changed(one) for one in files] or [0])

    def describe(self, folder):
        """Return it for JSON, with the paths and sizes of its files."""
        files = [[os.path.relpath(one, folder), size_of(one)] for one in self.files]
        return {
            "name": self.name,
            "state": self.state,
            "started": self.started,
            "seconds": None if self.started is None else max(0, self.ended - self.started),
            "size": self.size,
            "files": files,
        }

    def remove(self):
        """Delete it."""
        if os.path.isdir(self.path):
            shutil.rmtree(self.path)
        else:
            os.remove(self.path)


class Ros1(object):
    """`rosbag record`: NAME.bag, with `.active` behind it as long as it is written."""

    program, packages = "rosbag", "ros-%s-rosbag"
    #: States of bags that the recorder has closed, and that have no mark.
    unmarked = (CLOSED,)

    def __init__(self, folder):
        self.folder = folder

    def can_record(self):
        """Return whether the image has the recorder."""
        return bool(which("rosbag") and which("rosrun"))

    def command(self, seconds, most, topics):
        """Return the recorder's line.

        A kill loses the chunk that is being written, so each message is one. By itself the recorder
        ignores all messages, and goes on, where less than 1 GB is free. Each bag gets the latched
        messages, such as /tf_static, if the recorder can repeat them.
        """
        line = ["rosrun", "rosbag", "record", "--split", "--size=%d" % max(1, most >> 20)]
        line += ["--duration=%d" % seconds] if seconds else []
        line += ["--chunksize=0", "--min-space=1M"]
        if "--repeat-latched" in read_output(["rosrun", "rosbag", "record", "--help"]):
            line.append("--repeat-latched")
        return line + (topics or ["--all"])

    def bags(self):
        """Return all bags."""
        used, found = list_open(self.folder), []
        for entry in os.listdir(self.folder):
            path, name = os.path.join(self.folder, entry), re.sub(r"\.active$", "", entry)
            if name.endswith(".bag"):
                written = RECORDING if path in used else UNCLOSED
                state = CLOSED if name == entry else written
                found.append(Bag(name, path, [path], state, read_stamp(name)))
        return found

    def settle(self):
        """Do nothing: the recorder renames the bags that it has closed."""

    def close(self, bag):
        """Repair a bag that its recorder has not closed."""
        code = finish([sys.executable, "-c", REINDEX, bag.path])
        if code < 0:
            return  # the pod ends: the next one begins again
        os.utime(bag.path, (bag.ended, bag.ended))
        self.keep(bag, DAMAGED if code else REPAIRED)

    def keep(self, bag, mark):
        """Give a bag a mark, by which it is not deleted before the others."""
        os.rename(bag.path, os.path.join(self.folder, "%s-%s.bag" % (bag.name[:-4], mark)))

    def is_empty(self, bag):
        """Return whether a closed bag has no message: its first record counts the chunks."""
        with open(bag.path, "rb") as file:
            chunks = re.search(b"chunk_count=(....)", file.read(4096), re.S)
        return chunks is None or struct.unpack("<I", chunks.group(1)) == (0,)


class Ros2(object):
    """`ros2 bag record`: it begins one file after the other in the folder of its run.

    Each file gets a folder of its own when it is closed, since bags are deleted one by one.
    """

    program, packages = "rosbag2 with mcap", "ros-%s-ros2bag and ros-%s-rosbag2-storage-mcap"
    unmarked = (CLOSED, UNCLOSED)

    def __init__(self, folder):
        self.folder, self.runs = folder, os.path.join(folder, ".runs")
        self.help = ""

    def can_record(self):
        """Return whether the image has the recorder; keep what options that has."""
        if which("ros2"):
            self.help = read_output(["ros2", "bag", "record", "--help"])
        return "--max-bag-duration" in self.help and "mcap" in self.help

    def command(self, seconds, most, topics):
        """Return the recorder's line, whose options differ between distributions."""
        run = os.path.join(self.runs, time.strftime(STAMP))
        shutil.rmtree(self.runs, ignore_errors=True)  # every file has its folder now
        os.mkdir(self.runs)
        line = ["ros2", "bag", "record", "-s", "mcap", "-o", run, "--max-bag-size", str(most)]
        line += ["--max-bag-duration", str(seconds)] if seconds else []
        if "--storage-config-file" in self.help:
            config = os.path.join(self.runs, "mcap.yaml")
            with open(config, "w") as file:
                file.write(MCAP)
            line += ["--storage-config-file", config]
        if "--disable-keyboard-controls" in self.help:
            line.append("--disable-keyboard-controls")
        if not topics:
            return line + ["--all-topics" if "--all-topics" in self.help else "--all"]
        return line + (["--topics"] if "--topics" in self.help else []) + topics

    def bags(self):
        """Return all bags."""
        used, found = list_open(self.folder), []
        for entry in os.listdir(self.folder):
            path = os.path.join(self.folder, entry)
            if os.path.isdir(path) and read_stamp(entry):
                files = [os.path.join(path, one) for one in sorted(os.listdir(path))]
                started = read_number(path, "nanoseconds_since_epoch")
                started = started / 1e9 if started else read_stamp(entry)
                found.append(Bag(entry, path, files, CLOSED, started))
        for path in self.list_files():
            name = os.path.basename(path)[: -len(".mcap")]
            state = RECORDING if path in used else UNCLOSED
            found.append(Bag(name, path, [path], state, self.find_start(name)))
        return found

    def find_start(self, name):
        """Return when the file STAMP_NUMBER was begun: when the one before it was closed."""
        run, _, number = name.rpartition("_")
        if not number.isdigit() or number == "0":
            return read_stamp(name)
        before = "%s_%d" % (run, int(number) - 1)
        return changed(os.path.join(self.folder, before, before + ".mcap")) or None

    def list_files(self):
        """Return the files without a folder of their own, the oldest first."""
        found = []
        for above, _, names in os.walk(self.runs):
            found += [os.path.join(above, one) for one in names if one.endswith(".mcap")]
        return sorted(found, key=changed)

    def settle(self):
        """Give the files that the recorder has closed their folders; it begins the next one."""
        used = list_open(self.folder)
        for path in self.list_files()[:-1]:
            if path not in used:
                self.fold(path, "")

    def close(self, bag):
        """Give a file its folder; its recorder has written metadata if it has closed it."""
        closed = os.path.exists(os.path.join(os.path.dirname(bag.path), METADATA))
        self.fold(bag.path, "" if closed else "-" + REPAIRED)

    def keep(self, bag, mark):
        """Give a bag a mark, and a folder if it has none."""
        if bag.state == UNCLOSED:
            self.fold(bag.path, "-" + mark)
        else:
            os.rename(bag.path, "%s-%s" % (bag.path, mark))

    def fold(self, path, mark):
        """Move a file to a folder of its own, and write the metadata by which it is a bag."""
        name, times = os.path.basename(path), (changed(path), changed(path))
        made = os.path.join(self.runs, name[: -len(".mcap")])
        if not os.path.isdir(made):
            os.mkdir(made)
        os.rename(path, os.path.join(made, name))
        code = finish(["ros2", "bag", "reindex", made, "-s", "mcap"])
        if code < 0:
            return  # the pod ends: the next one begins again
        if code or not os.path.exists(os.path.join(made, METADATA)):
            mark = "-" + DAMAGED
        os.utime(os.path.join(made, name), times)
        os.rename(made, os.path.join(self.folder, os.path.basename(made) + mark))

    def is_empty(self, bag):
        """Return whether a closed bag has no message, by its metadata."""
        return read_number(bag.path, "message_count") == 0


class Recorder(object):
    """What `run` does: the image's recorder, and what the folder needs meanwhile."""

    def __init__(self, kind, split, limit, topics):
        self.kind, self.limit, self.topics = kind, limit, topics
        self.seconds = int(split[:-1]) if split.endswith("s") else 0
        self.box = None
        if topics and topics[0].startswith("--on="):
            faults, _, address = topics[0][len("--on=") :].partition("@")
            faults, self.topics = blackbox.Faults(faults.split(","), address, say), topics[1:]
            self.box = blackbox.BlackBox(kind, self.seconds, faults)
        # The bag that is being written cannot be deleted, so it may take a quarter.
        self.most = limit // 4 if self.seconds else min(limit // 4, int(split))
        self.seen = set()  # the paths of closed bags with messages
        self.child, self.stopping = None, False

    def stop(self, *_):
        """Handle a signal."""
        if self.child is not None and not self.stopping:
            interrupt(self.child)
        self.stopping = True

    def run(self):
        """Record until a signal; return the exit code."""
        signal.signal(signal.SIGINT, self.stop)
        signal.signal(signal.SIGTERM, self.stop)
        set_ready(False)
        if not self.kind.can_record():
            distro = os.environ.get("ROS_DISTRO", "DISTRO")
            say(MISSING % (self.kind.program, self.kind.packages.replace("%s", distro)))
            return 1
        self.repair()
        code = 0
        while not (code or self.stopping):
            self.sweep()
            if self.wait_for_room():
                code = self.record()
        return code

    def repair(self):
        """Repair what an earlier recorder has not closed."""
        for bag in self.kind.bags():
            if bag.state == UNCLOSED and not self.stopping:
                say("[rigel-k8s] %s was not closed and is being repaired" % bag.name)
                self.kind.close(bag)

    def wait_for_room(self):
        """Wait until the disk is not full any more; return whether to record then."""
        if self.is_full():
            say(FULL % (self.kind.folder, free(self.kind.folder) >> 20))
        while self.is_full() and not self.stopping:
            time.sleep(LOOK)
        return not self.stopping

    def is_full(self):
        """Return whether the disk has no room for a bag."""
        return free(self.kind.folder) < SPARE

    def wait_for_name(self):
        """Wait for a second in which no bag has begun: bags are named by it."""
        while any(bag.name.startswith(time.strftime(STAMP)) for bag in self.kind.bags()):
            time.sleep(0.1)

    def record(self):
        """Run the recorder; return 0 if it was ended, by a signal or since the disk is full."""
        self.wait_for_name()
        child = subprocess.Popen(
            self.kind.command(self.seconds, self.most, self.topics), cwd=self.kind.folder
        )
        self.child, full = child, False
        if self.stopping:  # the signal came a moment ago
            interrupt(child)
        while child.poll() is None:
            if not full and self.is_full():
                full = True
                interrupt(child)
            self.look()
            time.sleep(LOOK)
        self.child = None
        set_ready(False)
        for bag in self.kind.bags():
            if bag.state == UNCLOSED:
                self.kind.close(bag)
        self.sweep()
        until = time.time() + PATIENCE
        while not (full or self.stopping) and time.time() < until:
            time.sleep(0.1)
        if full or self.stopping:
            return 0
        say("[rigel-k8s] the recorder has ended with exit code %d" % child.returncode)
        return 1

    def look(self):
        """Write through what is recorded, and keep the limit."""
        (self.box or self.kind).settle()
        written = [bag.path for bag in self.kind.bags() if bag.state == RECORDING]
        for path in written:
            sync(path)
        set_ready(bool(written))
        self.sweep()

    def sweep(self):
        """Delete empty bags, and the oldest ones above the limit."""
        bags = sorted(self.kind.bags(), key=lambda bag: bag.ended)
        total = sum(bag.size for bag in bags)
        for bag in bags:
            if bag.state in (RECORDING, UNCLOSED):
                continue
            if bag.state != DAMAGED and bag.path not in self.seen and self.kind.is_empty(bag):
                say("[rigel-k8s] %s has no message and is deleted" % bag.name)
            elif total > self.limit:
                say("[rigel-k8s] %s is deleted: all bags together exceed the limit" % bag.name)
            else:
                self.seen.add(bag.path)
                continue
            bag.remove()
            total -= bag.size


def delete(kind, names):
    """Delete bags; return the exit code."""
    there = {bag.name: bag for bag in kind.bags()}
    for name in names:
        if name not in there:
            print("no bag %s" % name, file=sys.stderr)
            return 1
        if there[name].state in (RECORDING, UNCLOSED):
            print("%s is being written" % name, file=sys.stderr)
            return 1
    for name in set(names):
        there[name].remove()
    return 0


def list_open(folder):
    """Return the paths in a folder that a process of this container has open for writing."""
    found = set()
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            for number in os.listdir("/proc/%s/fd" % pid):
                path = os.readlink("/proc/%s/fd/%s" % (pid, number))
                if path.startswith(folder + "/") and is_writing(pid, number):
                    found.add(path)
        except OSError:
            continue  # it has ended, or is of another user
    return found


def is_writing(pid, number):
    """Return whether a process may write to one of its open files, not only read it."""
    try:
        with open("/proc/%s/fdinfo/%s" % (pid, number)) as file:
            flags = re.search(r"flags:\s*(\d+)", file.read())
    except (IOError, OSError):
        return False
    return flags is not None and int(flags.group(1), 8) & (os.O_WRONLY | os.O_RDWR) != 0


def read_stamp(name):
    """Return the time in a bag's name, None without one; recorders write their local time."""
    found = re.match(r"\d{4}(-\d\d){5}", name)
    return time.mktime(time.strptime(found.group(), STAMP)) if found else None


def read_number(folder, key):
    """Return the first number of a name in a bag's metadata, None without it."""
    try:
        with open(os.path.join(folder, METADATA)) as file:
            found = re.search(r"\b%s: (\d+)" % key, file.read())
    except (IOError, OSError):
        return None
    return int(found.group(1)) if found else None


def size_of(path):
    """Return a file's size, 0 if it is gone."""
    try:
        return os.path.getsize(path)
    except OSError:
        return 0


def changed(path):
    """Return when a file was written last, 0 if it is gone."""
    try:
        return os.path.getmtime(path)
    except OSError:
        return 0


def free(folder):
    """Return the bytes that are free on a folder's disk."""
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize


def sync(path):
    """Wait until what a process has written to a file is on the disk."""
    try:
        number = os.open(path, os.O_RDONLY)
    except OSError:
        return  # it was closed and renamed
    try:
        os.fsync(number)
    finally:
        os.close(number)


def set_ready(ready):
    """Make or remove the file that shows that a bag is being written."""
    if ready and not os.path.exists(READY):
        open(READY, "w").close()
    elif not ready and os.path.exists(READY):
        os.remove(READY)


def interrupt(child):
    """Ask a process to end."""
    try:
        child.send_signal(signal.SIGINT)
    except OSError:
        pass  # it has ended


def which(program):
    """Return whether a program is in PATH."""
    folders = os.environ.get("PATH", "").split(":")
    return any(os.access(os.path.join(one, program), os.X_OK) for one in folders)


def finish(line):
    """Run a program that ignores SIGINT; return its exit code, below 0 if it was killed."""
    return subprocess.Popen(line, preexec_fn=ignore_interrupt).wait()


def ignore_interrupt():
    """Ignore what stop.sh sends to all processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def read_output(line):
    """Return what a program prints, "" if it fails."""
    try:
        return subprocess.check_output(line, stderr=subprocess.STDOUT).decode("utf-8", "replace")
    except (OSError, subprocess.CalledProcessError):
        return ""


def say(text):
    """Print a line at once."""
    print(text)
    sys.stdout.flush()


def main(words):
    """Do what the command line requests; return the exit code."""
    folder, task, rest = os.path.realpath(words[0]), words[1], words[2:]
    if not os.path.isdir(folder):
        print("there is no folder %s" % folder, file=sys.stderr)
        return 1
    # Pods of ROS 1 have the variable.
    kind = (Ros1 if "ROS_IP" in os.environ else Ros2)(folder)
    if task == "run":
        return Recorder(kind, rest[0], int(rest[1]), rest[2:]).run()
    if task == "delete":
        return delete(kind, rest)
    bags = sorted(kind.bags(), key=lambda bag: bag.ended)
    print(json.dumps([bag.describe(folder) for bag in bags]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
