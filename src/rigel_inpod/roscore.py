"""roscore.py ROSCORE [ARGUMENT...]: runs roscore, and gives its master more time to start.

Why: roscore ends if its own master does not answer 10 s after its start. On an overloaded machine a
Python program may need longer than that only to start, and roscore would begin from the start each
time. roslaunch has no option for it. A version of roslaunch that keeps the limit elsewhere keeps
its own limit.
"""

import runpy
import sys

import roslaunch.launch

PATIENCE = 120.0  # seconds

roslaunch.launch._TIMEOUT_MASTER_START = PATIENCE
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
