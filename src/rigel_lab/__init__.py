"""A real Kubernetes on this machine, and images, from package registries alone.

Users have `rigel cluster` and `rigel image`, which entry points add (pyproject.toml); everything
else serves the demo and the tests of this project (`python -m rigel_lab`). README.md beside this
file has more.

cluster/   a cluster of Linux namespaces: lifecycle.py starts and ends it, components.py has its
           programs, node.py and control_plane.py their command lines
images/    base images and the project's own programs as images: base/ turns a recipe into an
           archive and delivers it, each other folder is a recipe
cli/       the words of both commands

It must not know Rigelfiles, jobs, releases or networks of applications.
"""

#: A command's module, its line in the help of `rigel`, and the command that it follows there.
CLUSTER = (
    "rigel_lab.cli.cluster",
    "A real Kubernetes on this machine: up, down, status, load.",
    "network",
)
IMAGE = (
    "rigel_lab.cli.images",
    "Images for machines that cannot pull from the internet.",
    "cluster",
)
