"""The live graph of a release's ROS nodes: read from inside a pod, judged, and drawn.

`reading.py` queries the cluster and returns a `RosGraph`; `problems.py` judges one; `drawing.py`
draws one. Two graphs of a release can be compared with `==` (`types.py` defines what counts).
`discovery/` checks whether DDS nodes discover each other across machines.
"""
