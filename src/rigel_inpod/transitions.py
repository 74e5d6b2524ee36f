"""Makes the transitions of a lifecycle node that its Rigelfile requests, at its start and end.

Why: a lifecycle node (a managed node) does nothing until it is configured and activated. With the
option `lifecycle` this script does that, and notes its progress for the probe (progress.py): so a
transition that fails is the cause that a user sees.

    transitions.py start /NODE TRANSITION...           ends when the last one is made
    transitions.py stop SECONDS /NODE TRANSITION...    ends then, at the latest after SECONDS

Contract: /NODE is the node's full ROS name; its services have their usual names. A transition that
fails at the start is tried again, at most 5 s later; one whose goal the node has already reached is
left out. At the end each is tried once. It runs in the node's own environment, with its rclpy.
"""

import os
import signal
import sys
import time

from lifecycle import DELAYS, GLANCE, SLOW, Hand, end
from progress import FINAL, Progress

GOALS = {
    "configure": "inactive",
    "activate": "active",
    "deactivate": "inactive",
    "cleanup": "unconfigured",
    "shutdown": "finalized",
}


class Mover(object):
    """Makes the transitions of one node."""

    def __init__(self, name, transitions, hand):
        self.name, self.transitions, self.hand = name, transitions, hand
        self.begun, self.failures = time.time(), 0

    def start(self):
        """Return when all transitions are made, after as many attempts as that takes."""
        self.report("starts", "%s has not offered its lifecycle services yet" % self.name)
        goal = GOALS[self.transitions[-1]]
        while self.hand.state(None) != goal:
            self.go_on()
        self.report("done", "%s is %s" % (self.name, goal))

    def go_on(self):
        """Make all transitions, up to the first that fails."""
        for transition in self.transitions:
            state = self.hand.state(None)
            if state is None:
                if time.time() > self.begun + SLOW:
                    line = "%s offers no lifecycle services: `lifecycle` is for lifecycle nodes"
                    self.report("starts", line % self.name)
                self.rest(GLANCE)
                return
            if state == GOALS[transition]:
                continue
            self.report("activates", "%s: %s" % (self.name, transition))
            if not self.hand.change(None, transition, 3600.0):
                self.failures += 1
                line = "%s is %s and has refused to %s (attempt %d); see its log"
                words = (self.name, state, transition, self.failures)
                self.report("failed", line % words)
                self.rest(DELAYS[min(self.failures, len(DELAYS)) - 1])
                return

    def stop(self, seconds):
        """Make the transitions, each once, while there is time."""
        until = time.time() + seconds
        for transition in self.transitions:
            self.hand.change(None, transition, max(0.1, until - time.time()))

    def rest(self, seconds):
        """Wait; a signal is handled meanwhile."""
        until = time.time() + seconds
        while time.time() < until:
            self.hand.spin(GLANCE)

    def report(self, step, line):
        """Note the step that is reached, and log it once."""
        Progress(step, line, pid=os.getpid()).report()


def main(words):
    """Run the script and return its exit code."""
    kind = words.pop(0)
    seconds = float(words.pop(0)) if kind == "stop" else 0.0
    name, transitions = words[0], words[1:]
    if kind == "start":
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: sys.exit(0))  # the pod ends
        Progress("starts", "%s: its lifecycle begins" % name, pid=os.getpid()).save()
    else:
        found = Progress.load()
        if found and found.step not in FINAL:
            end(found.pid)  # what still starts the node would undo this
    hand = Hand(name)
    try:
        mover = Mover(name, transitions, hand)
        if kind == "start":
            mover.start()
        else:
            mover.stop(seconds)
    finally:
        hand.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
