"""The gate: a program in front of roscore that hands node names over and remembers registrations.

It runs in its own container of the ros-master pod, mounted from a ConfigMap, on the Python 3.8 of
an official ROS image, with nothing but the standard library. It knows nothing of the rest of this
package. docs/ros1-updates.md explains what it does and why.

What it knows, and what follows from that; nothing here waits or asks:

registry.py    who publishes, subscribes and serves what: what the master knows
parameters.py  the parameter tree
state.py       both, and who waits for a name; changed by events, so that it can be kept
calls.py       the master's API: calls as values, answers
handover.py    which registration waits for a name, and when it gets it
recovery.py    what a new master lacks, what a living one knows besides

What it does; each module uses only those above it:

links.py       what it needs of the world around it: the master, the nodes, a clock
context.py     what the parts below share: state, links, log, turns, tasks
master.py      the way to the master: calls wait while it is away, and while a name changes hands
nodes.py       the way to nodes: whether they are there, what they hear from the gate
restoring.py   gives a new master what it lacks, believes one that has gone on
newcomers.py   nodes that wait for a name: what they register, are answered and hear meanwhile
takeover.py    gives names to those that wait; notes who took one without a hand-over
changes.py     answers calls that change what the master knows
gate.py        puts the parts together: every call comes here, and goes to one of them

How it runs:

memory.py      the state as events: in a file of the pod, and in one object of the cluster
http.py        XML-RPC over HTTP: the server, and the connections to the master and to nodes
cluster.py     the Kubernetes API, as far as the one object needs it
__main__.py    starts it; starts it again when it is killed
"""
