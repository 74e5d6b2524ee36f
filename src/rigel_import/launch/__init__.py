"""Launch files of ROS 1 and ROS 2 as drafts. They are read, never run on this computer.

Each tag is a function of a scope and an entity. ros1.py and ros2.py have one table of them each.
Files in Python are programs: the launch of the user's image says what they would start.

reading.py       the entry: the generation of ROS that a file is for, and its draft
ros1.py          the tags of roslaunch
ros2.py          the tags of ros2 launch
actions.py       what the tags of both share: arguments, includes, nodes
scope.py         what holds at one place of a file, and what its texts mean there
expressions.py   the form of `$(arg x)` and the like, and the value of `$(eval ...)`
parameters.py    values of parameters
packages.py      the packages of the workspace around a launch file
python.py        what a file in Python starts, as nodes
evaluation.py    the container in which it is evaluated
evaluator.py     the program in that container
entities.py      XML and YAML alike, as entities with their places
"""
