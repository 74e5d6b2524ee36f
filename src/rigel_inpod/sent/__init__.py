"""Programs that are sent into a pod with a request, and how.

They are not mounted, so a pod that an older version deployed can be examined by a newer one, and a
change of them restarts no robot. Nothing is written in the pod: the modules arrive on standard
input, as one line, and are imported from memory. They print JSON.

ros1_graph.py, ros1_parameters.py   the graph of ROS 1; Python 2.7 and newer
clock.py   the machine's clock; Python 2.7 and newer, without LOADER
ros1_tools.py, ros2_tools.py with lines.py   follow a topic, and call parameter services
notes.py with rmw_notes.py, of rigel_inpod   the graph of ROS 2, and who has discovered whom; 3.6
dds_graph.py with its modules, of rigel_exporter   the graph of DDS; 3.9 and newer
"""

from __future__ import annotations

import base64
import json
import zlib
from importlib.resources import files
from typing import Sequence

#: Python 2.7 and 3: makes modules from standard input, and runs the last one.
LOADER = """
import base64, json, sys, types, zlib
line = sys.stdin.readline()
sent = json.loads(zlib.decompress(base64.b64decode(line)).decode("utf-8"))
texts = dict(sent)
packages = {name.rpartition(".")[0] for name in texts}
def make(name):
    module = types.ModuleType(str(name))
    module.__package__ = str(name if name in packages else name.rpartition(".")[0])
    if name in packages:
        module.__path__ = []
    sys.modules[str(name)] = module
    exec(compile(texts[name], "<%s>" % name, "exec"), module.__dict__)
    if "." in name:
        parent, _, own = name.rpartition(".")
        setattr(sys.modules[parent], own, module)
for name, _ in sent[:-1]:
    make(name)
exec(compile(sent[-1][1], "<rigel-k8s>", "exec"), {"__name__": "__main__"})
"""

#: The Pythons of images of different ages; the probes try the same.
PYTHONS = ("python3", "python", "python2")
SHELL = """
for python in %s; do
  command -v "$python" >/dev/null 2>&1 && exec "$python" -S -E -B -c "$0" "$@"
done
echo 'its image has no %s' >&2
exit 127
"""


def choose_python(pythons: Sequence[str], program: str, *arguments: str) -> list[str]:
    """Return the command that runs a program on the first of these Pythons that an image has."""
    return ["/bin/sh", "-c", SHELL % (" ".join(pythons), pythons[-1]), program, *arguments]


def pack(modules: Sequence[tuple[str, str]]) -> bytes:
    """Return the line that LOADER reads.

    Args:
        modules: (import name, text), each after those that it imports; the last is run.
    """
    return base64.b64encode(zlib.compress(json.dumps(modules).encode())) + b"\n"


def read_module(name: str) -> str:
    """Return the text of a module of rigel_inpod, rigel_inpod.sent or rigel_exporter."""
    package, _, module = name.rpartition(".")
    return (files(package) / f"{module}.py").read_text(encoding="utf-8")
