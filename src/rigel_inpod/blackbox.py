"""Which bags are kept: those around what the exporter sees go wrong.

Why: of a robot that records all day, the minute around a fault is what somebody plays.
It asks the exporter, which knows what is expected of the topics, and whether the nodes are up. What
it does not know is no fault. It is independent of recorders. Python 2.7 and 3.
"""

import collections
import time

try:
    from urllib.request import ProxyHandler, build_opener
except ImportError:  # Python 2
    from urllib2 import ProxyHandler, build_opener

#: Seconds between two requests to the exporter, and that it has for an answer.
ASK, ANSWER = 5.0, 2.0
#: Seconds after which the exporter may see a fault: it measures rates over 30 s.
LATE = 45.0
#: A kind of fault, and the metrics that fall to 0 then, or are counters of it.
METRICS = {
    "breach": ("ros_topic_as_expected{",),
    "crash": ("ros_node_up{", "ros_node_restarts_total{"),
}
#: The beginning of the line with the exporter's own start.
BORN = "process_start_time_seconds"


class Faults(object):
    """What went wrong, and when; a fault that lasts is one."""

    def __init__(self, kinds, address, say):
        """`kinds` of METRICS; `address` of the exporter, HOST:PORT; `say` prints a line."""
        self._kinds, self._address, self._say = kinds, address, say
        self._known, self._born, self._asked, self._answers = {}, [], 0.0, True
        self.found = collections.deque(maxlen=100)

    def ask(self, now):
        """Ask the exporter if it is time; add (when, kind) to `found`."""
        if now < self._asked + ASK:
            return
        self._asked = now
        try:
            here = build_opener(ProxyHandler({}))  # the robot's own network needs no proxy
            text = here.open("http://%s/metrics" % self._address, timeout=ANSWER).read()
        except Exception as error:  # of any of the libraries below it
            if self._answers:
                self._say("[rigel-k8s] the exporter does not answer: %s" % error)
            self._answers = False
            return
        self._answers = True
        self.take(text.decode("utf-8", "replace"), now)

    def take(self, text, now):
        """Compare the metrics with those before."""
        lines = text.splitlines()
        born = [line for line in lines if line.startswith(BORN)]
        if born != self._born:  # an exporter that has just begun knows nothing
            self._born, self._known = born, {}
        for line in lines:
            name, _, value = line.rpartition(" ")
            for kind in self._kinds:
                # A node without a workload is not the application's.
                if name.startswith(METRICS[kind]) and 'workload=""' not in name:
                    old, new = self._known.get(name), float(value)
                    if old is not None and (old < new if "_total{" in name else old > new):
                        self._say("[rigel-k8s] %s: %s" % (kind, name))
                        self.found.append((now, kind))
                    self._known[name] = new

    def find(self, began, ended, around):
        """Return the kind of a fault in a time, or less than `around` seconds from it, or None."""
        near = (k for when, k in self.found if began - around < when < ended + around + LATE)
        return next(near, None)


class BlackBox(object):
    """Keeps the bags of a recorder that are near a fault, and deletes others when they are old."""

    def __init__(self, kind, seconds, faults):
        """`seconds` are kept before and after a fault; bags from before now are not touched."""
        self._kind, self._seconds, self._faults = kind, seconds, faults
        self._began = int(time.time())

    def settle(self):
        """Mark and delete bags; the newest one may not be closed yet."""
        now = time.time()
        self._faults.ask(now)
        for bag in sorted(self._kind.bags(), key=lambda bag: bag.ended)[:-1]:
            # In ROS 2 only a bag with metadata has a start.
            started = bag.ended - self._seconds if bag.started is None else bag.started
            if bag.state not in self._kind.unmarked or started < self._began:
                continue
            why = self._faults.find(started, bag.ended, self._seconds)
            if why:
                self._kind.keep(bag, why)
            elif bag.ended < now - self._seconds - LATE:
                bag.remove()
