"""roscore.py ROSCORE [ARGUMENT...]: runs roscore, with two things that it has no options for.

Why: PATIENCE. roscore ends if its own master does not answer 10 s after its start. On an overloaded
machine a Python program may need longer than that only to start, and roscore would begin from the
start each time.

ROSOUT. While this parameter is not set, rospy requests it from the master with each line that it
logs, and holds a lock meanwhile. A SIGINT that arrives then waits for that lock in the same thread:
the node hangs until it is killed. A parameter that is set is requested once. False is its default.

A version of roslaunch that keeps these elsewhere keeps its own.
"""

import runpy
import sys

import roslaunch.config
import roslaunch.core
import roslaunch.launch

PATIENCE = 120.0  # seconds
ROSOUT = "/rosout_disable_topics_generation"

load = getattr(roslaunch.config, "load_roscore", None)


def load_roscore(loader, config, **options):
    """Add the parameter to what roscore sets."""
    load(loader, config, **options)
    config.add_param(roslaunch.core.Param(ROSOUT, False), verbose=False)


roslaunch.config.load_roscore = load_roscore
roslaunch.launch._TIMEOUT_MASTER_START = PATIENCE
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
