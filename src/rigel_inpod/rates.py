"""How often a ROS 2 node publishes, where its Rigelfile has a limit (`readiness: {rates}`).

Why: a driver that is connected may still be too slow, and its new version must not take over then.
Two readings make a rate, and the probe has one only: the keeper measures, and notes what it finds.
Contract: RIGEL_K8S_RATES has TOPIC=LOWEST:HIGHEST of each, messages per second, with blanks between
them. What a node that waits to take over would publish counts as well. Python 3.6.
"""

import os
import time

import rmw_notes

FILE = "rates"  # beside the notes: lines of TOPIC RATE
SECONDS, MESSAGES = 2.0, 5  # a rate is that of so long, and of so many messages of the lowest rate
STALE = 10.0  # seconds after which no keeper measures: no reading is not silence
PAUSE = 0.5  # seconds between two readings


def parse(text):
    """Return (lowest, highest) by topic."""
    pairs = (word.partition("=") for word in text.split())
    return {topic: tuple(map(float, limits.split(":"))) for topic, _, limits in pairs}


def span(low):
    """Return over how many seconds a rate is measured."""
    return max(SECONDS, MESSAGES / low) if low else SECONDS


class Rates(object):
    """Those of a container, as the keeper measures them.

    Attributes:
        met: all are as they must be. due: when to look again.
    """

    def __init__(self, directory, limits):
        self._directory, self._limits = directory, limits
        self._begun, self._found = {}, {}
        self.met, self.due = not limits, 0.0 if limits else float("inf")

    def look(self, now):
        """Measure."""
        self.due = now + PAUSE
        counts, measured = self._count(), False
        for topic, (low, _) in self._limits.items():
            since, before = self._begun.get(topic, (now, counts[topic]))
            passed = now - since
            if counts[topic] < before:  # another process
                since, before = now, counts[topic]
            elif passed >= span(low):
                self._found[topic] = (counts[topic] - before) / passed
                since, before, measured = now, counts[topic], True
            self._begun[topic] = since, before
        self.met = all(
            low <= self._found.get(topic, -1.0) <= high
            for topic, (low, high) in self._limits.items()
        )
        if measured:
            lines = ["%s %.6g\n" % one for one in sorted(self._found.items())]
            path = os.path.join(self._directory, FILE)
            with open(path + ".new", "w") as opened:
                opened.writelines(lines)
            os.rename(path + ".new", path)

    def _count(self):
        counts = dict.fromkeys(self._limits, 0)
        for process in rmw_notes.read_all(self._directory):
            for one in () if process.ended or process.helper else process.entities:
                if one.kind == "publisher" and one.name in counts:
                    counts[one.name] += one.count + one.dropped
        return counts


def explain(directory, limits):
    """Return why a topic is not published as often as it must be, None if all are."""
    path, found = os.path.join(directory, FILE), {}
    if os.path.exists(path):
        slowest = max(span(low) for low, _ in limits.values())
        if time.time() - os.stat(path).st_mtime > STALE + slowest:
            return None
        with open(path) as opened:
            found = {topic: float(rate) for topic, rate in (line.split() for line in opened)}
    for topic, (low, high) in limits.items():
        if topic not in found:
            return "the rate of %s is not known yet" % topic
        if not low <= found[topic] <= high:
            words = "%g/s or more" % low if high == float("inf") else "%g..%g/s" % (low, high)
            return "%s is published %.3g times per second, not %s" % (topic, found[topic], words)
    return None
