"""Logs, metrics and dashboards of all applications of a cluster: a release of its own.

It stands above `rigel_k8s`, which never imports this package; what it adds is found by entry points
(pyproject.toml): `rigel observe`, the job type observability, and in each deploy of an application
what `guest.py` has. The core's own share is `rigel_k8s/observability/`: options, names, an
application's exporter, and readers of Loki and Prometheus.

boards/       dashboards, rules and alerts
manifests/    the objects of the stack and of each program, from its options; pure
install.py    the stack as a part of a job: its options, merged with those of other jobs; its hooks
password.py   Grafana's administrator
removal.py    the way back
status.py     the state of its parts
observing.py  its parts at ports of this machine
cli.py        the words of `rigel observe`; job.py: the job type
"""

#: The command's module, its line in the help of `rigel`, and the command that it follows there.
COMMAND = ("rigel_stack.cli", "Open Grafana, Prometheus and Loki here; status, remove.", "rbac")
