#!/bin/sh
# Runs the image's roscore with the Python that it names, and with patience (roscore.py).
#
# Why: images of different ages have roscore for Python 2 or 3, under different names.
# Contract: roscore.sh [ARGUMENT...]. A roscore that is not a Python program runs as it is.
# Needs sh.

found=$(command -v roscore) || exec roscore "$@" # fails with the usual message
IFS= read -r first <"$found"
case $first in
'#!'*python*) exec ${first#??} "${0%/*}/roscore.py" "$found" "$@" ;;
esac
exec "$found" "$@"
