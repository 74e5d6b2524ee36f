"""Reads what the layer notes of ROS 2 processes, and sets what they may do. Python 3.6.

Why: what passes through a process is known exactly only inside of it.

The twin of rigel_rmw/layer.h, which describes both kinds of files in the directory of a container:
`control`, which `Notes` writes, and one file for each process, which is only read here.

A key names an entity in every process of a workload (a hash of kind, node, name), a writer is the
publisher or client at the other end, a number counts what it has sent. Keys, writers and UUIDs of
goals are hexadecimal text, so all of it goes through JSON as it is.
"""

import os
import struct
import time
from collections import namedtuple

VERSION = 6
WORK, WAIT, HOLD, FINISH, STOP = range(5)
KINDS = ("", "node", "publisher", "subscription", "service", "client", "executor")
ASKED, OPEN, ENDED = 2, 3, 4  # states of a goal
BUSY, WAITING, UNKNOWN = range(3)  # what an executor does
EARLY = ("/rosout", "/parameter_events")  # on which a node publishes before it is complete
WINDOW = 10000000000  # ns
PULSE = 5000000000  # ns: an executor that waits, and says so each second, does not run any more
REST = 100000000  # ns: an executor that does not say what it does, and has done nothing for so long

CONTROL = struct.Struct("=8sIIII")
MODE_AT, HOLD_GOALS_AT, DROP_COUNT_AT = 12, 16, 20
DROP, DROPS = struct.Struct("=QQ"), 4096
FRIENDS_AT = CONTROL.size + DROPS * DROP.size
FRIEND, FRIENDS = struct.Struct("=II12s"), 256
OTHERS_AT = FRIENDS_AT + FRIENDS * FRIEND.size
CONTROL_SIZE = OTHERS_AT + FRIENDS * FRIEND.size
GOALS_KEY, ALL = 0x676F616C73, (1 << 64) - 1

HEAD = struct.Struct("=8sIIQQQIIIIIIII64s")
SEEN = 65536  # bytes of names
WRITER, WRITERS = struct.Struct("=Q8s16sQQQ"), 1024
GOAL, GOALS = struct.Struct("=II16s16sq"), 256
SLOT = struct.Struct("=IIII8s11Q14Q256s128s")
WRITERS_AT = HEAD.size + SEEN
GOALS_AT = WRITERS_AT + WRITERS * WRITER.size
SLOTS_AT = GOALS_AT + GOALS * GOAL.size

_Head = namedtuple(
    "_Head",
    "magic version pid birth stack looked used full ended taking helper goals seen free middleware",
)

#: A part of a node, or an executor. Times are ns of CLOCK_MONOTONIC, 0 for never.
#: kind: one of KINDS. name: of the topic, service or node with its namespace. node: the name of
#: its node. type: as in std_msgs/msg/String. key: names it in every process of the workload.
#: thread: an executor's. count: messages or requests that passed, turns of an executor.
#: answers: of a service and a client; of the publisher with which a lifecycle node reports its
#: transitions, the id of its state, 0 before the first one. bytes: of messages that the node has
#: serialized itself. last: the time of the last one, or when an executor last was seen to run:
#: while it waits that is renewed each second. matched: partners, as the middleware counts them.
#: age: ns between the last message's publication and its taking.
#: refused: calls that the middleware answered with an error.
#: dropped: what its mode did not let pass. longest: ns of the longest gap that ended within the
#: last minute.
Entity = namedtuple(
    "Entity",
    "kind name node type key thread created count answers bytes last matched age refused dropped"
    " longest",
)

#: A process with the layer. pid: in the namespace of its container. full: entities for which its
#: file had no place. ended: it has ended, or runs another program. mode: what it may do. seen: the
#: nodes that it has discovered, its own among them; those of one name one by one. helper: a program
#: of ours beside the node. stands: ns for which one of its executors has not looked for work, 0
#: while all wait for some. goals: the actions that it serves and that have an unfinished goal.
Process = namedtuple("Process", "pid full ended mode seen entities helper stands goals")


def read_all(directory):
    """Yield the processes of a container.

    Raises:
        OSError: the directory cannot be read.
    """
    mode = WORK
    if os.path.exists(os.path.join(directory, "control")):
        with open(os.path.join(directory, "control"), "rb") as opened:
            mode = struct.unpack_from("=I", opened.read(CONTROL.size), MODE_AT)[0]
    for name in sorted(os.listdir(directory)):
        text = _read(os.path.join(directory, name)) if name.isdigit() else None
        if text is not None:
            yield _process(text, mode)


def find_other_versions(directory):
    """Return the versions of a container's notes that this reader cannot read.

    The scripts of a pod are replaced when another version of rigel deploys; its processes are not.

    Raises:
        OSError: the directory cannot be read.
    """
    found = set()
    for name in filter(str.isdigit, os.listdir(directory)):
        try:
            with open(os.path.join(directory, name), "rb", 0) as opened:
                head = opened.read(12)
        except FileNotFoundError:
            continue  # ended meanwhile
        if len(head) == 12 and head[:8] == b"rigelrmw":
            found.update(struct.unpack("=I", head[8:]))
    return found - {VERSION}


def describe(directory):
    """Return what running processes say, as JSON has it: with `now`, ns of their clock."""
    processes = []
    for process in read_all(directory):
        if process.ended or process.helper:
            continue
        entities = [entity._asdict() for entity in process.entities]
        processes.append(dict(process._asdict(), entities=entities))
    return {"now": now(), "processes": processes}


class OtherVersion(OSError):
    """A container's processes have a layer of another version than the program that reads them."""


class Notes:
    """A container's processes, for the one program that lets them work and wait: the keeper.

    Helpers of ours are left out everywhere. The files of processes that have ended are removed.

    Args:
        directory: of the container.
        mode: what its processes may do if none of them has started yet.

    Raises:
        OSError: the directory cannot be written; OtherVersion: it is that of another layer.
    """

    def __init__(self, directory, mode=WORK):
        self._directory = directory
        path = os.path.join(directory, "control")
        if not os.path.exists(path):
            _make_control(path, mode)
        self._control = os.open(path, os.O_RDWR)
        head = os.pread(self._control, CONTROL.size, 0)
        if len(head) < CONTROL.size or CONTROL.unpack(head)[:2] != (b"rigelctl", VERSION):
            os.close(self._control)
            raise OtherVersion("%s is not of this version of the layer" % path)

    @property
    def mode(self):
        """What the processes may do."""
        return struct.unpack("=I", os.pread(self._control, 4, MODE_AT))[0]

    def set_mode(self, mode):
        """Set it for all of them at once; a message that is being taken is not stopped."""
        self._write(MODE_AT, mode)

    def set_hold_goals(self, hold):
        """Leave requests for new goals of actions in the middleware's queue, or take them."""
        self._write(HOLD_GOALS_AT, int(hold))

    def processes(self):
        """Yield the processes that run."""
        mode = self.mode
        for text in self._texts():
            yield _process(text, mode)

    def alive(self):
        """Whether a process runs."""
        return any(True for _ in self._texts(HEAD.size))

    def identify(self):
        """Return the processes, each with when it started."""
        heads = (_head(text) for text in self._texts(HEAD.size))
        return sorted((head.pid, head.birth, head.stack) for head in heads)

    def fit(self):
        """Whether every process has a node, and has turned its executor or published by itself."""
        fit = [_is_fit(process.entities) for process in self.processes()]
        return bool(fit) and all(fit)

    def is_taking(self):
        """Whether a thread takes something that it began to take before the mode was set."""
        return any(_head(text).taking for text in self._texts(HEAD.size))

    def is_idle(self):
        """Whether no executor runs something of the node.

        A thread that shares its work with one that waits may wait for its turn: it counts as idle
        shortly after it has taken something, so that timers do not count. So do executors that are
        called when something arrives after a short rest: they never say.
        """
        slots = [slot for text in self._texts() for slot in _slots(text)]
        executors = [slot[5:] for slot in slots if KINDS[slot[0]] == "executor"]
        shared = {one[6] for one in executors if one[5] == WAITING}
        since = now() - REST
        return all(
            one[5] == WAITING
            or (one[5] == UNKNOWN and one[4] < since)
            or (one[6] in shared and one[8] < since)
            for one in executors
        )

    def survey(self):
        """Return (keys of the nodes, key to number of partners of each other entity).

        The number is 0 of a service and a client.
        """
        nodes, partners = set(), {}
        for one in self._entities():
            if one.kind == "node":
                nodes.add(one.key)
            elif one.kind != "executor":
                partners[one.key] = partners.get(one.key, 0) + one.matched
        return sorted(nodes), partners

    def doubled(self):
        """Return how many nodes were discovered beside another one of their name, and of none here.

        In an update that is a new version that waits.
        """
        own, most = {one.name for one in self._entities() if one.kind == "node"}, 0
        for text in self._texts():
            names = [name for name in _seen(text) if name not in own]
            most = max(most, len(names) - len(set(names)))
        return most

    def name(self, keys):
        """Return what the parts of these keys are named here."""
        return sorted({one.name for one in self._entities() if one.key in keys})

    def newest(self):
        """Return the newest message or request of each writer that was handed to a node.

        Shape: {key: {writer: number}}. Messages that build up state (latched, /tf, warm) are not in
        it: each process takes all of them.
        """
        return self._numbers(3)

    def dropped(self):
        """Return the newest of each writer that the mode did not let pass, in the same shape."""
        return self._numbers(4)

    def hears(self, within):
        """Return whose messages and requests have arrived, whether the mode let them pass or not.

        Shape: {key: [writer]}; the writer "" stands for all of a key whose messages build up state,
        which are not noted one by one.

        Args:
            within: seconds.
        """
        found, built_up, since, mode = {}, set(), now() - int(within * 1e9), self.mode
        for text in self._texts():
            for row in WRITER.iter_unpack(text[WRITERS_AT:GOALS_AT]):
                if row[0] > 1 and row[5] >= since:
                    found.setdefault(row[1].hex(), set()).add(row[2].hex())
            for one in _process(text, mode).entities:
                if one.kind == "subscription" and one.count and one.last >= since:
                    built_up.add(one.key)
        for key in built_up:
            found.setdefault(key, {""})
        return {key: sorted(writers) for key, writers in found.items()}

    def goals(self):
        """Return the goals that were asked for, UUID to whether it is not finished."""
        texts = (text[GOALS_AT:SLOTS_AT] for text in self._texts())
        found = [goal for text in texts for goal in GOAL.iter_unpack(text)]
        return {one[2].hex(): one[0] != ENDED for one in found if one[0] in (ASKED, OPEN, ENDED)}

    def unanswered(self):
        """Return how many clients of actions wait for a result."""
        results = [one for one in self._entities() if one.name.endswith("/_action/get_result")]
        return sum(max(one.count - one.answers, 0) for one in results if one.kind == "service")

    def write_drop(self, newest, uuids):
        """Write what another container's processes have taken, before these may work.

        Args:
            newest: their `newest()`: up to these numbers nothing is handed to a node here.
            uuids: their goals, of which results and cancelling are theirs.
        """
        self._write(DROP_COUNT_AT, 0)
        table = [(0, 0)] * DROPS
        entries = [(_tag(GOALS_KEY, uuid), ALL) for uuid in uuids]
        for key, writers in newest.items():
            number = int.from_bytes(bytes.fromhex(key), "little")
            entries += [(_tag(number, writer), newest) for writer, newest in writers.items()]
        for tag, number in entries[: DROPS // 2]:
            at = (tag >> 20) % DROPS
            while table[at][0] not in (0, tag):
                at = (at + 1) % DROPS
            table[at] = (tag, number)
        os.pwrite(self._control, b"".join(DROP.pack(*one) for one in table), CONTROL.size)
        self._write(DROP_COUNT_AT, len(entries))

    def friends(self):
        """Return how the identifiers of the container's processes begin, helpers among them."""
        return read_friends(self._control)

    def set_known(self, prefixes):
        """Say of which processes here the other pods know that their requests are not for them."""
        for at, (pid, known, prefix) in enumerate(self._read_friends()):
            if pid and known != (prefix.hex() in prefixes):
                self._write(FRIENDS_AT + at * FRIEND.size + 4, not known)

    def set_others(self, prefixes):
        """Drop what processes of the workload's other pods request: their own pod answers."""
        found = [FRIEND.pack(1, 0, bytes.fromhex(one)) for one in prefixes[:FRIENDS]]
        os.pwrite(self._control, b"".join(found).ljust(FRIENDS * FRIEND.size, b"\0"), OTHERS_AT)

    def _read_friends(self):
        table = os.pread(self._control, FRIENDS * FRIEND.size, FRIENDS_AT)
        return FRIEND.iter_unpack(table)

    def _entities(self):
        return [one for process in self.processes() for one in process.entities]

    def _numbers(self, column):
        found = {}
        for text in self._texts():
            for row in WRITER.iter_unpack(text[WRITERS_AT:GOALS_AT]):
                if row[0] > 1 and row[column]:
                    writers, writer = found.setdefault(row[1].hex(), {}), row[2].hex()
                    writers[writer] = max(row[column], writers.get(writer, 0))
        return found

    def _texts(self, size=None):
        for name in os.listdir(self._directory):
            path = os.path.join(self._directory, name)
            text = _read(path, size) if name.isdigit() else None
            if text is None or _head(text).helper:
                continue
            if _has_ended(_head(text)):
                os.unlink(path)
            else:
                yield text

    def _write(self, at, word):
        os.pwrite(self._control, struct.pack("=I", word), at)


def read_friends(control):
    """Return how the identifiers of a container's processes begin, by its open file `control`."""
    table = FRIEND.iter_unpack(os.pread(control, FRIENDS * FRIEND.size, FRIENDS_AT))
    return sorted({prefix.hex() for pid, _, prefix in table if pid})


def _make_control(path, mode):
    made = "%s.%d" % (path, os.getpid())
    with open(made, "wb") as opened:
        os.fchmod(opened.fileno(), 0o666)
        opened.write(CONTROL.pack(b"rigelctl", VERSION, mode, 0, 0).ljust(CONTROL_SIZE, b"\0"))
    try:
        os.link(made, path)
    except FileExistsError:
        pass  # a process was quicker
    finally:
        os.unlink(made)


def _read(path, size=None):
    """Return a process' file as far as it is used; None if it is not one of this version."""
    try:
        with open(path, "rb", 0) as opened:
            head = os.pread(opened.fileno(), HEAD.size, 0)
            if len(head) < HEAD.size or head[:12] != b"rigelrmw" + struct.pack("=I", VERSION):
                return None
            used = size or SLOTS_AT + _head(head).used * SLOT.size
            return os.pread(opened.fileno(), used, 0)
    except FileNotFoundError:
        return None


def _head(text):
    return _Head(*HEAD.unpack_from(text))


def _slots(text):
    return list(SLOT.iter_unpack(text[SLOTS_AT : SLOTS_AT + _head(text).used * SLOT.size]))


def _has_ended(head):
    """Whether the process is not there any more, or runs another program."""
    if head.ended:
        return True
    try:
        with open("/proc/%d/stat" % head.pid) as opened:
            fields = opened.read().rpartition(")")[2].split()
    except OSError:
        return True
    other = int(fields[25]) not in (0, 1, head.stack)  # 0 or 1: it may not be seen
    return fields[0] in "ZX" or int(fields[19]) != head.birth or other


def _is_fit(entities):
    kinds = [one.kind for one in entities]
    published = {
        one.name for one in entities if one.kind == "publisher" and one.count + one.dropped
    }
    return "node" in kinds and ("executor" in kinds or bool(published.difference(EARLY)))


def _process(text, mode):
    head, slots = _head(text), _slots(text)
    return Process(
        head.pid,
        head.full,
        _has_ended(head),
        WORK if head.helper else mode,
        tuple(sorted(_seen(text))),
        tuple(_entity(slot, slots) for slot in slots if 0 < slot[0] < len(KINDS)),
        bool(head.helper),
        _measure_stand(slots),
        tuple(sorted(set(_busy_actions(text, slots)))),
    )


def _seen(text):
    count = _head(text).seen
    return [_text(name) for name in text[HEAD.size : WRITERS_AT].split(b"\0", count)[:count]]


def _busy_actions(text, slots):
    for state, service, _, _, _ in GOAL.iter_unpack(text[GOALS_AT:SLOTS_AT]):
        if state in (ASKED, OPEN) and service < len(slots):
            yield _text(slots[service][-2]).partition("/_action/")[0]


def _measure_stand(slots):
    """Return the longest time for which an executor has not looked for work.

    Threads that share their work look for it one after the other; executors that are called when
    something arrives do not look for it.
    """
    found, at = {}, now()
    for slot in slots:
        if KINDS[slot[0]] == "executor" and slot[10] != UNKNOWN:
            silence = max(0, at - slot[9])
            stands = silence if silence > PULSE or slot[10] == BUSY else 0
            executor = slot[11] or ("thread", slot[2])
            found[executor] = min(stands, found.get(executor, stands))
    return max(found.values(), default=0)


def _entity(slot, slots):
    kind, node, thread, _, key = slot[:5]
    created, count, answers, size, last, _, _, matched, age, refused, dropped = slot[5:16]
    gaps = zip(slot[16:30:2], slot[17:30:2])
    longest = [gap for window, gap in gaps if window >= now() // WINDOW - 6]
    its_node = _text(slots[node][-2]) if node < len(slots) else ""
    return Entity(
        *(KINDS[kind], _text(slot[-2]), its_node, _text(slot[-1]), key.hex(), thread),
        *(created, count, answers, size, last, matched, age, refused, dropped),
        max(longest, default=0),
    )


def _tag(key, name):
    """Return layer_mix(key, name)."""
    first, second = struct.unpack("=QQ", bytes.fromhex(name))
    total = (key ^ first) * 0x9E3779B97F4A7C15 & ALL
    total = ((total ^ total >> 32) ^ second) * 0xC2B2AE3D27D4EB4F & ALL
    return (total ^ total >> 29) | 1


def now():
    """Return the time of the processes' clock in ns."""
    return int(time.monotonic() * 1e9)


def _text(raw):
    return raw.partition(b"\0")[0].decode("utf-8", "replace")
