"""Second networks for pods: Multus and whereabouts on a cluster.

It stands above `rigel_k8s`, which never imports this package; what it adds is found by entry points
(pyproject.toml): `rigel network`, the job type network, and in each deploy of an application what
`guest.py` has.

platform.py      distributions of Kubernetes: where their machines keep CNI's files; pure
manifests.py     Multus and whereabouts as objects; pure
installation.py  which of them a cluster has, and whose they are; what is installed; pure
interfaces.py    pods that lack their interface
install.py       installs them as a release, and lets each machine prove that it attaches pods
proving.py       the pods and marks of that proof
removal.py       removes them in an order in which machines keep starting pods
status.py        the state of both on each machine
preflight/       whether a release's network can work on this cluster
cli.py           the words of `rigel network`; job.py: the job type
"""

#: The command's module, its line in the help of `rigel`, and the command that it follows there.
COMMAND = (
    "rigel_multus.cli",
    "Second networks for pods: install, status, remove Multus.",
    "observe",
)
