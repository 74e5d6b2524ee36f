"""Scripts that run inside the application's own containers; they import no other package of ours.

They are mounted from a ConfigMap into every container of an application, so that any image can be
probed, stopped and entered without being changed. They need a POSIX sh, and Python 2.7 or 3
with its standard library; those marked with 3.6 are for images of ROS 2. README.md has what several
of them share: stopping, probing, completing a command line.

Probes: the startup and the readiness probe.

ready.sh       finds a Python, and runs one of the next two
ready.py       ROS 1: are the nodes of this container registered, and do they answer?
dds_ready.py   DDS and zenoh: do its processes take part, and read what they are sent? (3.6)
rmw_ready.py   ROS 2: does the node exist, turn its executor, and work? (3.6)
memory.py      what earlier probes found
progress.py    what a script beside the node has done, for the probe
container.py   the container's processes and ports
rosrpc.py      XML-RPC to masters and nodes, quick to start; the exporter uses it too

DDS' protocol, for the probe and the exporter (3.6):

dds_local.py   the container's own participants
rtps.py, interfaces.py, spdp.py   the protocol, the network's interfaces, what participants
               announce; spdp.py is the exporter's alone, and not mounted

Starting, beside a node, stopping, entering:

python.sh                  becomes the Python of a program of ROS
start.sh, start.py         complete the command line, with
substitution.py, rosparameters.py   `$(find ...)`, and parameters of files
globalparameters.py        sets the job's global parameters
beside.sh                  starts one of the next three and becomes the node's program
nodelets.py, components.py load `components` in ROS 1 and 2, with loading.py
transitions.py             makes the transitions of `lifecycle` (3.6)
join.py                    carries the frames of a program on another computer
dev.sh                     starts the node's program again when its files have changed
stop.sh                    the preStop hook: SIGINT to every ROS process
exec.sh, rc.sh             give a command, or an interactive bash, the node's environment

Bags, in the pod of `record`:

record.sh, record.py       run the image's recorder, keep the limit, repair what was not closed
blackbox.py                keeps the bags around a fault that the exporter sees

ROS 2's layer, a library in the node's processes (rigel_rmw):

rmw.sh         starts a program with it, and the keeper beside it
keeper.py, handover.py     agree with the workload's other pods which of them works (3.6)
lean.py        runs them in less memory (3.6)
rates.py       how often the node publishes where that counts (3.6)
rmw_notes.py   reads what it notes, and sets what the processes may do (3.6)

roscore:

roscore.sh, roscore.py     run the image's roscore with more patience and one parameter more
keep.sh                    starts a roscore that has ended again in the same container

sent/          programs that are sent into a pod with a request, and how
"""

from __future__ import annotations

from importlib.resources import files

__all__ = ["MOUNT_PATH", "scripts"]

#: Where the ConfigMap is mounted, read-only.
MOUNT_PATH = "/rigel-k8s"

_NAMES = (
    "beside.sh",
    "blackbox.py",
    "components.py",
    "container.py",
    "dds_local.py",
    "dds_ready.py",
    "dev.sh",
    "exec.sh",
    "globalparameters.py",
    "handover.py",
    "interfaces.py",
    "join.py",
    "keep.sh",
    "keeper.py",
    "lean.py",
    "loading.py",
    "memory.py",
    "nodelets.py",
    "progress.py",
    "python.sh",
    "rates.py",
    "rc.sh",
    "ready.py",
    "ready.sh",
    "record.py",
    "record.sh",
    "rmw.sh",
    "rmw_notes.py",
    "rmw_ready.py",
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
