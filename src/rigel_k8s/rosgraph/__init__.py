"""The live graph of a release's ROS nodes: read from inside a pod, judged, and drawn.

`reading.py` asks the cluster and returns a `RosGraph`; `problems.py` judges one; `drawing/` makes
pictures of one. Two graphs of a release can be compared with `==` (`types.py` says what counts).
The check whether DDS nodes discover each other across machines is another package, `graph/`.
"""
