"""Makes the transitions of a lifecycle node that its Rigelfile requests, at its start and end.

Why: a lifecycle node (a managed node) does nothing until it is configured and activated. With the
option `lifecycle` this script does that, and notes its progress for the probe (progress.py): so a
transition that fails is the cause that a user sees.

    transitions.py start /NODE TRANSITION...           ends when the last one is made
    transitions.py stop SECONDS /NODE TRANSITION...    ends then, at the latest after SECONDS

Contract: /NODE is the node's full ROS name; its services have their usual names. A transition that
fails at the start is tried again, at most 5 s later; one whose goal the node has already reached is
left out. At the end each is tried once. It runs in the node's own environment, with its rclpy.
While two pods have a node of this name, both answer, and perhaps only the other one was reached. So
with the layer, what counts are the notes of the node's own process (rmw_notes.py), not answers.
"""

import os
import signal
import sys
import time

import rmw_notes
from progress import FINAL, Progress

SLOW = 15.0  # seconds after which a node is reported to offer no lifecycle services
ANSWER = 1.0  # seconds that a node has to answer; then it is asked again
GLANCE = 0.05  # seconds between looks
DELAYS = (1.0, 2.0, 5.0)  # seconds until a transition that failed is tried again
FINALIZED, MOVING = "finalized", "in a transition"

STATES = (
    "unconfigured",
    "unconfigured",
    "inactive",
    "active",
    FINALIZED,
)  # by id; 0: has not moved

GOALS = {
    "configure": "inactive",
    "activate": "active",
    "deactivate": "inactive",
    "cleanup": "unconfigured",
    "shutdown": FINALIZED,
}


class Hand(object):
    """A hidden ROS node that calls the services of the lifecycle node."""

    def __init__(self, name):
        """`name` is the full ROS name of the lifecycle node."""
        import rclpy
        from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions
        from rclpy.executors import SingleThreadedExecutor

        rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self._name, self._shutdown = name, rclpy.shutdown
        self._layer = "/rmw-" in os.environ.get("LD_PRELOAD", "")  # set by rmw.sh
        self._change, self._get = ChangeState, GetAvailableTransitions
        self._node = rclpy.create_node(
            "_rigel_k8s_lifecycle_%d" % os.getpid(),
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._clients = {}

    def state(self):
        """Return the node's state, None if it is not there yet or does not answer."""
        if self._layer:
            event = find("publisher", self._name + "/transition_event")
            if event is None:
                return None
            return STATES[event.answers] if event.answers < len(STATES) else MOVING
        answer = self._call(self._get, "get_available_transitions", self._get.Request())
        if answer is None:
            return None
        found = [one.start_state.label for one in answer.available_transitions]
        return found[0] if found else FINALIZED

    def change(self, transition, seconds):
        """Return whether the node has made a transition."""
        request = self._change.Request()
        request.transition.label = transition
        if not self._layer:
            answer = self._call(self._change, "change_state", request, seconds)
            return answer is not None and answer.success
        before, until, rest = self._answered(), time.time() + seconds, ANSWER
        while self._answered() == before and time.time() < until:
            self._call(self._change, "change_state", request, min(rest, seconds))
            again = time.time() + rest
            while self._answered() == before:
                if time.time() > (until if self.state() == MOVING else min(again, until)):
                    break
                self.spin(GLANCE)
            rest *= 2  # it may only be busy
        return self.state() == GOALS[transition]

    def _answered(self):
        service = find("service", self._name + "/change_state")
        return service.answers if service else 0

    def _call(self, kind, service, request, seconds=ANSWER):
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, self._name + "/" + service)
        client, until = self._clients[service], time.time() + seconds
        while not client.service_is_ready():
            if time.time() > until:
                return None
            self.spin(0.01)
        future = client.call_async(request)
        while not future.done() and time.time() < until:
            self.spin(GLANCE)  # in slices, so that a signal is handled between two
        if not future.done():
            client.remove_pending_request(future)
            return None
        return future.result()

    def spin(self, seconds):
        """Do what is due, at most for that long."""
        self._executor.spin_once(timeout_sec=seconds)

    def close(self):
        """Leave DDS."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._shutdown()


def find(kind, name):
    """Return a part of this container's nodes by the notes of their processes, None without it."""
    for process in rmw_notes.read_all(os.environ["RIGEL_RMW"]):
        for one in process.entities if not process.ended else ():
            if (one.kind, one.name) == (kind, name):
                return one
    return None


class Mover(object):
    """Makes the transitions of one node."""

    def __init__(self, name, transitions, hand):
        self.name, self.transitions, self.hand = name, transitions, hand
        self.begun, self.failures = time.time(), 0

    def start(self):
        """Return when all transitions are made, after as many attempts as that takes."""
        self.report("starts", "%s has not offered its lifecycle services yet" % self.name)
        goal = GOALS[self.transitions[-1]]
        while self.hand.state() != goal:
            self.go_on()
        self.report("done", "%s is %s" % (self.name, goal))

    def go_on(self):
        """Make all transitions, up to the first that fails."""
        for transition in self.transitions:
            state = self.hand.state()
            if state is None:
                if time.time() > self.begun + SLOW:
                    line = "%s offers no lifecycle services: `lifecycle` is for lifecycle nodes"
                    self.report("starts", line % self.name)
                self.rest(GLANCE)
                return
            if state == GOALS[transition]:
                continue
            self.report("activates", "%s: %s" % (self.name, transition))
            if not self.hand.change(transition, 3600.0):
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
            self.hand.change(transition, max(0.1, until - time.time()))

    def rest(self, seconds):
        """Wait; a signal is handled meanwhile."""
        until = time.time() + seconds
        while time.time() < until:
            self.hand.spin(GLANCE)

    def report(self, step, line):
        """Note the step that is reached, and log it once."""
        Progress(step, line, pid=os.getpid()).report()


def end(pid):
    """End a process of ours that still works for the node."""
    for number, times in ((15, 100), (9, 1)):  # SIGTERM, SIGKILL
        try:
            os.kill(pid, number)
            for _ in range(times):
                time.sleep(0.01)
                os.kill(pid, 0)
        except OSError:
            return


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
