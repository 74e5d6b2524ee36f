"""How a node of these images is called, and what it says: as the example's talker and listener."""

import os
import re
import sys

sys.path.insert(0, os.environ["INTEROP"])


def role():
    """Return the first word: talker, listener."""
    return sys.argv[1]


def name():
    """Return what `-r __node:=NAME` calls the node, else NODE_NAME, else its role."""
    told = [
        found[1] for found in (re.fullmatch("__node:=(.+)", word) for word in sys.argv) if found
    ]
    return (told + [os.environ.get("NODE_NAME", role())])[0]


def greeting(number):
    """Return what is said."""
    return f"hello world from {name()}: none {number}"


def heard(text):
    """Log what arrived."""
    log(f"I heard {text}")


def log(text):
    """Write a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
