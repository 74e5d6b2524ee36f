"""Hands a lifecycle node over from the old pod to the new one: ROS 2's updates without doubles.

Why: DDS accepts two nodes of one name, and then every message arrives twice. A lifecycle node can
be started and configured while it does nothing. So the new pod's node waits, and is activated at
the moment when the old pod's node is deactivated.

    lifecycle.py take TOKEN                configures this pod's node; activates it once no other
                                           pod's node works; then ends
    lifecycle.py leave [--wait SECONDS]    deactivates this pod's node, which is about to end

Contract: RIGEL_K8S_LIFECYCLE is the node's full ROS name. lifecycle.sh has put TOKEN into the names
of the node's services change_state and get_available_transitions. So the ROS graph shows which pods
there are, and each pod's node can be called separately. A token is tSECONDS_POD, from the start of
the container. Of several nodes that wait, the newest takes over; of a pod with several tokens only
the newest counts, since its container has crashed. Progress keeps what was reached in a file, for
the probe. `leave` returns 0 if the node was deactivated, else 1. It runs in the node's own
environment, with its rclpy.
"""

import os
import sys
import time

from progress import Progress

ACTIVE, INACTIVE, UNCONFIGURED, FINALIZED = "active", "inactive", "unconfigured", "finalized"
#: States in which a node of another pod must end first; None: it does not answer.
WORKING = (ACTIVE, "activating", "deactivating", None)

SETTLE = 3.5  # seconds until an active node was discovered; DDS announces at least every 3 s
SLOW = 15.0  # seconds after which a node is reported to offer no lifecycle services
WATCH = 10.0  # seconds for which a node that met no other one checks whether it was mistaken
STRANGER = 60.0  # seconds that a node of this name outside rigel's pods may take to end
ANSWER = 1.0  # seconds that a node has to answer; then it is asked again
PAUSE = 1.0  # seconds between looks at all nodes; transitions and graph changes show at once
GLANCE = 0.05  # seconds between looks at the graph
DELAYS = (1.0, 2.0, 5.0)  # seconds until a transition that failed is tried again


def pod_of(token):
    """Return a token's pod, spelled as in ROS names."""
    return token.partition("_")[2]


def age_of(token):
    """Return the sort key of tokens: a later one is larger."""
    seconds = token.partition("_")[0][1:]
    return int(seconds) if seconds.isdigit() else 0, pod_of(token)


def decide(own, state, others, strangers=0, waited=0.0):
    """Return (what to do, for which pod it waits): configure, activate, wait, or done.

    Args:
        own: this pod's token; state: its node's.
        others: token -> state of the other pods' nodes, None for one that does not answer.
        strangers: how many more nodes have this name, outside rigel's pods.
        waited: for how many seconds it could have been active.
    """
    if state == UNCONFIGURED:
        return "configure", ""
    if state != INACTIVE:
        return ("done", "") if state == ACTIVE else ("wait", "")
    newest = {pod_of(token): token for token in sorted([own, *others], key=age_of)}
    for token, doing in sorted(others.items()):
        if newest[pod_of(token)] != token:  # of a container that has crashed, and runs again
            continue
        newer = age_of(token) > age_of(own)
        if doing in WORKING or (doing == INACTIVE and newer):
            return "wait", pod_of(token)
    if strangers > 0 and waited < STRANGER:
        return "wait", "a node outside rigel's pods"
    return "activate", ""


class Hand(object):
    """A hidden ROS node that calls the services of nodes."""

    def __init__(self, name):
        """`name` is the full ROS name of the node to hand over."""
        import rclpy
        from lifecycle_msgs.msg import TransitionEvent
        from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions
        from rclpy.executors import SingleThreadedExecutor

        rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self.name, self.base = name, name + "/_rigel_k8s/"
        self._shutdown = rclpy.shutdown
        self._change, self._get = ChangeState, GetAvailableTransitions
        self.node = rclpy.create_node(
            "_rigel_k8s_lifecycle_%d" % os.getpid(),
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.moved = False
        self.node.create_subscription(TransitionEvent, name + "/transition_event", self._note, 10)
        self._clients = {}

    def _note(self, _):
        self.moved = True

    def pods(self):
        """Return the tokens of all pods whose node is visible."""
        found = (name for name, _ in self.node.get_service_names_and_types())
        tails = (name[len(self.base) :] for name in found if name.startswith(self.base))
        return {tail.partition("/")[0] for tail in tails if tail.endswith("/change_state")}

    def count(self):
        """Return how many nodes have the name."""
        names = self.node.get_node_names_and_namespaces()
        return sum(1 for n, space in names if space.rstrip("/") + "/" + n == self.name)

    def state(self, token):
        """Return the state of a pod's node, None if it does not answer.

        Without a token it is the node whose services have their usual names.
        """
        answer = self._call(self._get, token, "get_available_transitions", self._get.Request())
        if answer is None:
            return None
        found = [one.start_state.label for one in answer.available_transitions]
        return found[0] if found else FINALIZED

    def change(self, token, transition, seconds):
        """Return whether a pod's node has made a transition; a token as in `state`."""
        request = self._change.Request()
        request.transition.label = transition
        answer = self._call(self._change, token, "change_state", request, seconds)
        return answer is not None and answer.success

    def _call(self, kind, token, service, request, seconds=ANSWER):
        name = (self.base + token if token else self.name) + "/" + service
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client, until = self._clients[name], time.time() + seconds
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
        self.executor.spin_once(timeout_sec=seconds)

    def close(self):
        """Leave DDS."""
        self.executor.shutdown()
        self.node.destroy_node()
        self._shutdown()


class Taker(object):
    """Takes over for this pod's node."""

    def __init__(self, name, token, hand):
        self.name, self.token, self.hand = name, token, hand
        self.begun = self.heard = time.time()  # when the own node was last seen
        self.met = False  # the one active node was seen, so there is no need to listen longer
        self.alone = False  # it was activated here without meeting another one
        self.failures = 0

    def run(self):
        """Return when the node is active."""
        self.report("starts", "%s has not offered its lifecycle services yet" % self.name)
        while self.token not in self.hand.pods():
            if time.time() > self.begun + SLOW:
                line = "%s offers no lifecycle services: HandOver is for lifecycle nodes"
                self.report("starts", line % self.name)
            self.hand.spin(GLANCE)
        self.heard = time.time()
        while not (self.step() and self.stays()):
            pass

    def stays(self):
        """Return whether the node stays active: no older active node was discovered late."""
        until = time.time() + (WATCH if self.alone else 0)
        while time.time() < until:
            pods, self.hand.moved = self.hand.pods(), False
            for token in pods - {self.token}:
                if age_of(token) < age_of(self.token) and self.hand.state(token) == ACTIVE:
                    self.report("starts", "%s gives way to %s" % (self.name, pod_of(token)))
                    self.met, self.alone = True, False
                    self.hand.change(self.token, "deactivate", 3600.0)
                    return False
            self.rest(pods, PAUSE)
        return True

    def step(self):
        """Look, and do what is due; return whether all is done."""
        pods, self.hand.moved = self.hand.pods(), False
        state = self.hand.state(self.token)
        others = {token: self.hand.state(token) for token in pods if token != self.token}
        strangers = self.hand.count() - len(pods | {self.token})
        self.met = self.met or any(doing in WORKING[:-1] for doing in others.values())
        settled = self.met or time.time() > self.begun + SETTLE
        waited = time.time() - self.heard
        what, whom = decide(self.token, state, others, strangers, waited)
        if what == "done":
            self.report("active", "%s is active" % self.name)
            return True
        if what == "configure":
            return self.change("configure", "starts")
        if what == "activate" and settled:
            return self.change("activate", "activates")
        if state == INACTIVE and whom and not self.failures:
            self.report(
                "waits", "%s is inactive and waits to take over from %s" % (self.name, whom)
            )
        self.rest(pods, PAUSE if settled else GLANCE)
        return False

    def change(self, transition, step):
        """Make a transition; return whether the node is active now."""
        self.report(step, "%s: %s" % (self.name, transition))
        if self.hand.change(self.token, transition, 3600.0):
            self.failures = 0
            if transition == "activate":
                self.alone = not self.met
                self.report("active", "%s is active" % self.name)
            return transition == "activate"
        self.failures += 1
        line = "%s has refused to %s, %d times; see its log"
        self.report("failed", line % (self.name, transition, self.failures))
        until = time.time() + DELAYS[min(self.failures, len(DELAYS)) - 1]
        while time.time() < until:
            self.hand.spin(GLANCE)
        return False

    def rest(self, pods, seconds):
        """Wait until something may have changed."""
        until = time.time() + seconds
        while time.time() < until and not self.hand.moved and self.hand.pods() == pods:
            self.hand.spin(GLANCE)

    def report(self, step, line):
        """Note the step that is reached, and log it once."""
        Progress(step, line, self.token, os.getpid()).report()


def take(name, token):
    """Return when the node is active."""
    import signal

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit(0))  # the pod ends: it takes over nothing
    Progress("starts", "%s: the hand-over starts" % name, token, os.getpid()).save()
    hand = Hand(name)
    try:
        Taker(name, token, hand).run()
    finally:
        hand.close()
    return 0


def leave(name, seconds):
    """Return 0 if the node was active and is deactivated."""
    until, found = time.time() + seconds, Progress.load()
    if found is None:
        return 1
    end(found.pid)
    if found.step not in ("active", "activates"):
        return 1
    hand = Hand(name)
    gone = hand.change(found.token, "deactivate", max(0.1, until - time.time()))
    hand.close()
    return 0 if gone else 1


def end(pid):
    """End the process that waits: a node that is about to end takes nothing over."""
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
    name = os.environ.get("RIGEL_K8S_LIFECYCLE", "")
    if words[:1] == ["take"] and len(words) == 2 and name:
        return take(name, words[1])
    if words[:1] == ["leave"] and name:
        return leave(name, float(words[2]) if len(words) > 2 else 4.0)
    sys.stdout.write("wrong arguments: take TOKEN|leave [--wait SECONDS]\n")
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
