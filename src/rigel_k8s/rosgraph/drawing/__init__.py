"""Pictures of a ROS graph as text: SVG, DOT for Graphviz, Mermaid; pure.

`picture.py` chooses what is shown, the same for all forms; `layout.py` places it with `columns.py`,
`rows.py` and `heights.py`; one module for each form writes it.
"""
