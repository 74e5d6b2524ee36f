"""Stacks of Eclipse Muto as nodes of a release.

A stack is JSON that names ROS programs, parameters and remappings. This package reads it with the
places of its values and translates it into the options of `nodes`. It is independent of Kubernetes
and of those options' classes: the result is a tree of values that a Rigelfile could contain, too.

expansion, converting   what others call: the option `muto` of a job, and a whole Rigelfile
translation, nodes      from stacks to nodes
archives, unpacking     sources that come with a stack, and the node that launches them
gathering               a stack with those that it names
opening, library, twin  where stacks are found: in files, and in a Ditto
arguments               `$(arg x)`, and what only a container can resolve
parameters, types       parameters of a node or a stack; what a text means as a value
formats, stack          the forms of stacks, recognized by their keys; the model
reading, remarks        text with places; what to report about a value
"""

#: The command's module, and its line in the help of `rigel`; an entry point of this package.
COMMAND = ("rigel_muto.cli", "Use stacks of Eclipse Muto, and take its commands.")
