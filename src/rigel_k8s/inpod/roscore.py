"""roscore.py ROSCORE [ARGUMENT...]: runs roscore, and lets its master start slowly.

Why: roscore ends when its own master does not answer 10 s after its start. On a machine with far
too much to do a Python program takes longer than that only to start, and roscore would begin from
the start each time. roslaunch has no option for it. Where another version of roslaunch keeps the
limit elsewhere, its own limit holds.
"""

import runpy
import sys

import roslaunch.launch

PATIENCE = 120.0  # seconds

roslaunch.launch._TIMEOUT_MASTER_START = PATIENCE
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
