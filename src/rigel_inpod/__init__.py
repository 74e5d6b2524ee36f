"""Scripts that run inside the application's own containers; they import no other package of ours.

Everything here but this module and `sent/` is mounted from a ConfigMap into every container of an
application, so that any image can be probed, stopped, entered and looked around in without being
changed. They need a POSIX sh; the probes a Python 2.7 or 3, those for DDS a Python 3.6, with
nothing but its standard library. docs/in-pod-scripts.md is their manual.
"""

from __future__ import annotations

from importlib.resources import files

__all__ = ["MOUNT_PATH", "scripts"]

#: Where the ConfigMap is mounted, read-only.
MOUNT_PATH = "/rigel-k8s"

_NAMES = (
    "beside.sh",
    "components.py",
    "container.py",
    "dds_local.py",
    "dds_ready.py",
    "exec.sh",
    "globalparameters.py",
    "interfaces.py",
    "keep.sh",
    "lifecycle.py",
    "lifecycle.sh",
    "loading.py",
    "memory.py",
    "nodelets.py",
    "progress.py",
    "rc.sh",
    "ready.py",
    "ready.sh",
    "roscore.py",
    "roscore.sh",
    "rosparameters.py",
    "rosrpc.py",
    "rtps.py",
    "start.py",
    "start.sh",
    "stop.sh",
    "substitution.py",
    "transitions.py",
)


def scripts() -> dict[str, str]:
    """Return the scripts, file name to text."""
    room = files("rigel_inpod")
    return {name: (room / name).read_text(encoding="utf-8") for name in _NAMES}
