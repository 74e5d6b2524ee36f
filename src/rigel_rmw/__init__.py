"""A library inside of ROS 2 processes, between ROS 2 and its middleware.

layer.c is loaded before ROS 2 into a node's process (`LD_PRELOAD`), and keeps in a file of the
directory `RIGEL_RMW` what nodes, publishers, subscriptions, services, clients and executors it has,
and what passes through them. layer.h describes the file; rigel_inpod/rmw_notes.py reads it.

hatch_build.py in the root of the project compiles it, for both kinds of machines, into lib/.
"""

from __future__ import annotations

from importlib.resources import files

__all__ = ["libraries"]

MACHINES = ("x86_64", "aarch64")


def libraries() -> dict[str, bytes]:
    """Return the compiled layer of each machine by its file's name; empty if it was not built."""
    room = files("rigel_rmw") / "lib"
    paths = [room / f"rmw-{machine}.so" for machine in MACHINES]
    if not all(path.is_file() for path in paths):
        return {}
    return {path.name: path.read_bytes() for path in paths}
