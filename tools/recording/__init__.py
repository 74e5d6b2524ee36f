"""A recorded run for the README: real commands on a real cluster, as a moving picture.

`python -m tools.recording --context NAME` runs the commands and writes docs/recording.svg. The
cluster must be able to pull ros:noetic, and have two machines.

commands.py   runs commands, and records their output
drawing.py    screens of a terminal as SVG, in a light and a dark form
"""
