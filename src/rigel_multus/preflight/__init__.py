"""Whether a second network can work on this cluster: facts in, findings out; pure.

The facts come in as plain data (objects as the cluster returns them, and a script's output on each
machine); only look.py asks a cluster. docs/errors.md has the table of findings.
"""
