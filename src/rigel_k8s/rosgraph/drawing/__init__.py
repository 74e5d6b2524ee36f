"""Pictures of a ROS graph in DOT; pure.

`picture.py` chooses what is shown, `dot.py` writes it.
"""
