"""Loads what a node has as `components`, one after the other, until all of it is there.

Why: a component that cannot be loaded must be what the readiness probe reports. One that could only
not be loaded yet, since its device was not there, must start without a user's help. nodelets.py
(ROS 1) and components.py (ROS 2) do the loading itself. Python 2.7 and 3.
"""

import json
import os
import signal
import time

from progress import Progress

PAUSE = 0.5  # seconds between two looks for the node that loads
DELAYS = (1.0, 2.0, 5.0)  # seconds until a refused component is tried again


class NotYet(Exception):
    """The node cannot be called now; the message is the cause."""


class Refused(Exception):
    """The node has not loaded a component; the message is the node's, perhaps empty."""


def load_file(path, make_loader):
    """Return when all components of a JSON file are loaded; make_loader gets the node's name."""
    with open(path) as file:
        plan = json.load(file)
    load_all(plan, make_loader(plan["node"]))


def load_all(plan, loader):
    """Return when all components are loaded.

    Args:
        plan: the node's name as "node", its "components", each with "name" and "plugin".
        loader: find() raises NotYet while the node cannot be called, load(component) raises
            Refused.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))  # the pod ends
    name = plan["node"]
    report("starts", "%s does not load components yet" % name)
    for component in plan["components"]:
        load(name, component, loader)
    names = ", ".join(component["name"] for component in plan["components"])
    report("done", "%s has loaded %s" % (name, names))


def load(name, component, loader):
    """Return when a component is loaded, after as many attempts as that takes."""
    what, failures = "%s (%s)" % (component["name"], component["plugin"]), 0
    while True:
        try:
            loader.find()
            report("loads", "%s is loading %s" % (name, what))
            loader.load(component)
            return
        except NotYet as why:
            report("starts", "%s does not load components yet: %s" % (name, why))
            time.sleep(PAUSE)
        except Refused as why:
            failures += 1
            cause = str(why) or "see its log"
            report("failed", "%s cannot load %s (attempt %d): %s" % (name, what, failures, cause))
            time.sleep(DELAYS[min(failures, len(DELAYS)) - 1])


def report(step, line):
    """Note the step that is reached, and log it."""
    Progress(step, line, pid=os.getpid()).report()
