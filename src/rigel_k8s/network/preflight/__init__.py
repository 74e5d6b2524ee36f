"""Whether a second network can work on this cluster: facts in, findings out; pure.

What is looked at comes in as plain data (objects as the cluster tells them, and what a script said
on each machine); nothing here asks a cluster. docs/errors.md lists the findings.
"""
