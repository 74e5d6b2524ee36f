"""What a program that is sent into a pod prints while it goes on: a line of JSON each. Python 2.7.

Why: messages may come faster than the connection takes them. Then the oldest are dropped and
counted, so that what is printed is always new.

Contract: the program ends when standard input does, which its caller holds open: also if that is
killed or cut off. What it cannot do is its last line: `error`, a word, and `text` for people.
"""

import json
import os
import signal
import sys
import threading
from collections import deque

MOST = 100  # messages that wait to be printed
PATIENCE = 3.0  # seconds to leave the graph in good order


class Failure(Exception):
    """What cannot be done: a word that the caller recognizes, and a text for people."""

    def __init__(self, word, text):
        Exception.__init__(self, text)
        self.word = word


def run(program):
    """Call a function with the request, and end when it returns or standard input ends."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    watch = threading.Thread(target=_watch)
    watch.daemon = True
    watch.start()
    try:
        program(json.loads(sys.argv[1]))
    except Failure as error:
        write({"error": error.word, "text": str(error)})
    except (KeyboardInterrupt, EnvironmentError):
        pass  # the caller has gone
    os._exit(0)


def _watch():
    """Interrupt the main thread when standard input ends, and end the process soon after."""
    sys.stdin.read()
    late = threading.Timer(PATIENCE, os._exit, [0])
    late.daemon = True
    late.start()
    os.kill(os.getpid(), signal.SIGINT)


def write(answer):
    """Print one line."""
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


class Queue(object):
    """The newest messages, from the thread that receives to the thread that prints.

    Args:
        most: how many wait, None for all.
    """

    def __init__(self, most=MOST):
        self._waiting, self._changed = deque(), threading.Condition()
        self._most, self._dropped = most, 0

    def put(self, message):
        """Add a message."""
        with self._changed:
            if len(self._waiting) == self._most:
                self._waiting.popleft()
                self._dropped += 1
            self._waiting.append(message)
            self._changed.notify()

    def get(self):
        """Return the oldest message, and how many have been dropped in all."""
        with self._changed:
            while not self._waiting:
                self._changed.wait(0.5)  # Python 2.7 handles no signal in a wait without an end
            return self._waiting.popleft(), self._dropped


class Plain(object):
    """Makes values that JSON has of messages.

    Attributes:
        most: elements of an array and characters of a text that are kept, None for all.
        shortened: whether more were there.
    """

    def __init__(self, most):
        self.most, self.shortened = most, False

    def text(self, value):
        """Return a text."""
        return value if self._fits(value) else value[: self.most] + "..."

    def items(self, values, make):
        """Return an array; `make` makes one element."""
        if self._fits(values):
            return [make(value) for value in values]
        return [make(value) for value in values[: self.most]] + ["..."]

    def _fits(self, value):
        fits = self.most is None or len(value) <= self.most
        self.shortened = self.shortened or not fits
        return fits


def print_messages(queue, request, convert):
    """Print messages, all or `count` of them.

    Args:
        convert: makes a plain value of (message, Plain).
    """
    left = request["count"]
    while left is None or left > 0:
        message, dropped = queue.get()
        plain = Plain(request["most"])
        answer = {"message": convert(message, plain), "dropped": dropped}
        write(dict(answer, shortened=plain.shortened))
        left = None if left is None else left - 1


def select(message, path):
    """Return a part of a message, by the names of its fields.

    Raises:
        Failure: there is no such field.
    """
    for name in path:
        fields = list_fields(message)
        if name not in fields:
            text = "it has no fields" if not fields else "its fields are: " + ", ".join(fields)
            raise Failure("no-field", 'no field "%s": %s' % (name, text))
        message = getattr(message, name)
    return message


def list_fields(message):
    """Return the names of a message's fields, in their order; none of another value."""
    if hasattr(message, "get_fields_and_field_types"):
        return list(message.get_fields_and_field_types())
    return list(message.__slots__) if hasattr(message, "_slot_types") else []


class Counter(object):
    """Counts messages, and prints once a second what came."""

    def __init__(self, clock):
        self._clock, self._since, self._last = clock, clock(), None
        self._count, self._gap, self._lock = 0, 0.0, threading.Lock()

    def add(self, _):
        """Count a message."""
        with self._lock:
            at = self._clock()
            self._gap = max(self._gap, at - (self._last or at))
            self._count, self._last = self._count + 1, at

    def take(self):
        """Return the rate and the longest gap since the last call."""
        with self._lock:
            at = self._clock()
            gap = max(self._gap, at - self._last) if self._last else None
            found = {"rate": self._count / max(at - self._since, 1e-9), "gap": gap}
            self._since, self._count, self._gap = at, 0, 0.0
        return found
