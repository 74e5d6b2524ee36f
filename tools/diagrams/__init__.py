"""The diagrams of the documentation, drawn from short descriptions.

`python -m tools.diagrams` writes docs/pictures/; a test compares the files with the descriptions.

pictures.py   what each diagram shows
scene.py      boxes, frames around them and arrows, at places on a plane
sequence.py   messages between participants, from top to bottom
svg.py        shapes and texts as SVG, in a light and a dark form
"""
