"""The gate: a program in front of roscore that hands node names over and remembers registrations.

It runs in its own container of the ros-master pod, mounted from a ConfigMap, on the Python 3.8 of
an official ROS image, with nothing but the standard library. It imports no other package of ours.
docs/ros1-updates.md explains what it does and why.

What it keeps, and what follows from that; nothing here waits or calls:

registry.py    who publishes, subscribes and serves what: a copy of the master's registrations
parameters.py  the parameter tree
state.py       both, and which nodes wait for a name; changed by events, so that it can be kept
calls.py       the master's API: calls as values, answers
handover.py    which registration waits for a name, and when it gets it
recovery.py    what a new master is missing, what a living one has in addition

What it does; each module uses only those above it:

links.py       what it needs of the world around it: the master, the nodes, a clock
context.py     what the parts below share: state, links, log, turns, tasks
master.py      the way to the master: calls wait while it is down, and while a name changes hands
nodes.py       the way to nodes: whether they are there, what they hear from the gate
restoring.py   gives a new master what it is missing; trusts one that has not restarted
newcomers.py   nodes that wait for a name: what they register, are answered and receive meanwhile
takeover.py    gives names to those that wait; notes nodes that took one without a hand-over
gate.py        every call arrives here; one that changes registrations is passed on, or waits

How it runs:

memory.py      the state as events: in a file of the pod, and as a text for the cluster
cluster.py     the part of the Kubernetes API that the text's one object needs
keeper.py      keeps the state in both; finds the newer one at the start
http.py        XML-RPC over HTTP: the server, and the connections to the master and to nodes
__main__.py    starts it; starts it again when it is killed
"""
