"""Global parameters of ROS 1: set at the master, and again when it has lost them. Python 2.7 and 3.

Why: many nodes read one global parameter, so no single node's container can set it. A parameter
that is changed at run time stays changed while the master runs, also when this container restarts:
a mark beside the parameters shows that they were set. A master that has lost them has also lost the
mark.
Contract: the only line of STATE is "set" while they are set, otherwise the reason why they are not.
"""

import hashlib
import json
import os
import signal
import sys
import time

import rosparameters
from substitution import Failure

#: What the readiness probe looks at.
STATE = "/tmp/rigel-k8s-global-parameters"
PERIOD = 1.0  # seconds


def keep(name, trees):
    """Keep parameters at the master until this container ends.

    Args:
        name: the full name of the parameter that is the mark.
    """
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: os._exit(0))
    values = rosparameters.flatten(trees)
    text = json.dumps(values, sort_keys=True, default=repr)
    mark = {
        "digest": hashlib.sha256(text.encode("utf-8")).hexdigest(),
        "names": [name for name, _ in values],
    }
    if os.path.exists(STATE):  # of an earlier container
        os.remove(STATE)
    master = rosparameters.connect()
    before = ""
    while True:
        try:
            if set_again(master, name, mark, values):
                log("%d global parameters are set" % len(values))
            state = "set"
        except Exception as error:  # of sockets, HTTP and XML-RPC; the next attempt may succeed
            state = "the global parameters are not set: " + rosparameters.describe(error)
        if state != before:
            if state != "set":
                log(state)
            write(state)
            before = state
        time.sleep(PERIOD)


def set_again(master, name, mark, values):
    """Set the parameters if the mark is missing; return whether it was."""
    found = master.getParam(name) if master.hasParam(name) else {}
    if found.get("digest") == mark["digest"]:
        return False
    for old in found.get("names", ()):
        if old not in mark["names"] and master.hasParam(old):
            master.deleteParam(old)
    for full, value in values:
        master.setParam(full, value)
    master.setParam(name, mark)
    return True


def write(state):
    """Write for the readiness probe; raise Failure if this container cannot."""
    try:
        with open(STATE, "w") as file:
            file.write(state + "\n")
    except EnvironmentError as error:
        raise Failure("cannot write %s: %s; mount a volume at /tmp" % (STATE, error.strerror))


def log(text):
    """Print a line to the container's log."""
    sys.stdout.write("rigel: %s\n" % text)
    sys.stdout.flush()
