"""What people already have, as a Rigelfile: `rigel import launch` and `rigel import compose`.

It stands above `rigel_k8s`, which never imports this package; an entry point (pyproject.toml) adds
its command.

draft.py     nodes and options on their way into a Rigelfile, with what is not carried over, and
             the Rigelfile's text
text.py      files that are imported, as text
compose/     Docker Compose files as drafts
launch/      launch files of ROS 1 and ROS 2 as drafts
cli.py       the command's words
"""

#: The command's module, and its line in the help of `rigel`; an entry point of this package.
COMMAND = ("rigel_import.cli", "Write a Rigelfile from launch or compose files.")
