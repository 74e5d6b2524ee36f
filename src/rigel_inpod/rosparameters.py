"""Parameters of ROS 1: read from files as rosparam does, and set at the master. Python 2.7 and 3.

Why: rosparam's own modules read its YAML (`deg(90)`, several documents) and speak the master's
protocol; they are in every image with ROS 1, and are imported only where they are needed.
"""

import os
import socket
import sys
import time

from substitution import Failure

CALLER = "/rigel_start"
#: Seconds for an answer of the master; without a limit a lost machine would block for minutes.
PATIENCE = 10.0


def load(path, namespace):
    """Return [(namespace, tree)] of a YAML file."""
    if not os.path.isfile(path):
        raise Failure("there is no parameter file %s in this image" % path)
    rosparam = import_ros("rosparam")
    try:
        return [(space, tree) for tree, space in rosparam.load_file(path, namespace)]
    except Exception as error:  # of YAML, and of rosparam's own conversions
        words = " ".join(str(error).split())
        raise Failure("the parameter file %s cannot be read: %s" % (path, words))


def import_ros(name):
    """Return a module of ROS."""
    try:
        return __import__(name)
    except ImportError:
        raise Failure("this image has no %s for Python, or ROS is not set up" % name)


def flatten(trees):
    """Return [(full name, value)] of trees; the last one of a name wins."""
    found = {}
    for namespace, tree in trees:
        add(found, namespace.rstrip("/"), tree)
    return sorted(found.items())


def add(found, name, value):
    """Add the values below a name."""
    if not isinstance(value, dict):
        found[name] = value
        return
    for key in value:
        add(found, "%s/%s" % (name, key), value[key])


def connect():
    """Return the master, a client of its XML-RPC."""
    socket.setdefaulttimeout(PATIENCE)
    return import_ros("rosgraph").Master(CALLER)


def set_all(trees):
    """Set parameters at the master, as soon as it answers."""
    master = wait_for_master()
    for name, value in flatten(trees):
        try:
            master.setParam(name, value)
        except Exception as error:
            raise Failure("the parameter %s cannot be set: %s" % (name, describe(error)))


def wait_for_master():
    """Return the master once it answers; a line of the log has the cause of the wait."""
    master, reported = connect(), False
    while True:
        try:
            master.getPid()
            return master
        except Exception as error:
            if not reported:
                sys.stdout.write("rigel: waiting for the ROS master: %s\n" % describe(error))
                sys.stdout.flush()
                reported = True
            time.sleep(1)


def describe(error):
    """Return an exception's words on one line."""
    return " ".join(str(error).split()) or error.__class__.__name__
