"""The live graph of a release's ROS nodes: read from inside its pods, judged, compared and drawn.

It stands above `rigel_k8s`, which never imports this package; what it adds is found by entry points
(pyproject.toml): `rigel graph`, `expect`, `topic` and `param`, and what `guest.py` has.

types.py         a graph as plain values; two of a release can be compared with `==`
reading.py       reads one, by pods.py (the release's pods), and ros1.py, ros2.py or dds.py
problems.py      judges one; drawing.py and layout.py draw one
comparison.py    whether an update has made it worse; expectations.py: whether it is as expected
discovery/       whether DDS nodes discover each other across machines
watching.py      reads it before and after an update; idle.py: waits until the robot is idle
hooks.py         does both around a deploy
status.py        what `rigel status` shows of all that
hz.py, tools.py  follow a topic in a pod that runs
commands/        what its commands do; cli/: their words
"""

CLI = "rigel_graph.cli"
#: A command's module, its line in the help of `rigel`, and the command that it follows there.
GRAPH = (f"{CLI}.graph", "Show the ROS graph: nodes by machine, topics, what is wrong.", "status")
EXPECT = (f"{CLI}.expect", "Compare topics with what the Rigelfile expects; learn it.", "graph")
TOPIC = (f"{CLI}.topics", "List ROS topics, print their messages, measure their rates.", "logs")
PARAM = (f"{CLI}.params", "List, get and set the parameters of a ROS node.", "topic")
