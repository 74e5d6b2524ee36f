"""Prints the time of this machine's clock for each line of standard input. Python 2.7 and 3.

    clock.py TURNS

Contract: one line of seconds since 1970 at once for each line; ends after TURNS of them, or with
standard input: an old kubelet cannot pass its end on.
"""

import sys
import time

for _ in range(int(sys.argv[1])):
    if not sys.stdin.readline():
        break
    sys.stdout.write("%.6f\n" % time.time())
    sys.stdout.flush()
