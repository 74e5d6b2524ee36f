"""Pictures of a ROS graph as text: DOT for Graphviz, Mermaid; pure.

`picture.py` chooses what is shown, the same for all forms; one module for each form writes it.
"""
