"""The end of a cluster: all that it made is removed, in whatever state it is."""

from __future__ import annotations

import shutil
from pathlib import Path

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster import cgroups, kubeconfig, machine, network, shared
from rigel_lab.cluster.commands import Report
from rigel_lab.cluster.paths import boot_id, names
from rigel_lab.cluster.state import State

#: What is mounted where, for this process.
MOUNTS = Path("/proc/self/mountinfo")


def remove(state: State, report: Report) -> None:
    """End a cluster's processes and remove what it made.

    An obstacle is reported, and a second `remove` continues: the state is removed last.
    """
    layout = state.layout
    if state.boot == boot_id():
        for name in reversed(state.machine_names):
            machine.end(state.directory / name, layout.namespace(name))
        network.remove(layout, state.machine_names)
        cgroups.remove(state.name)
    with shared.exclusive():
        for file, before in state.kubeconfigs.items():
            hand_over(state.context, file, before)
            kubeconfig.remove(Path(file), state.context, before)
    remove_tree(state.directory)
    others = filter(None, map(State.load, names()))
    needed = {path for other in others for path in other.node_paths.binds}
    shared.release(state.name, report, needed)


def hand_over(context: str, file: str, before: str | None) -> None:
    """Let clusters that started after a context go back to the one before it."""
    for other in filter(None, map(State.load, names())):
        if other.kubeconfigs.get(file) == context:
            other.kubeconfigs[file] = before
            other.save()


def remove_tree(path: Path) -> None:
    """Remove a cluster's directory; never across a mount, and its state last.

    Raises:
        LocalClusterError: something is mounted in it.
    """
    mounts = [line.split()[4] for line in MOUNTS.read_text().splitlines()]
    if inside := [mount for mount in mounts if Path(mount).is_relative_to(path)]:
        raise LocalClusterError(f"{inside[0]} is still mounted", hint=f"umount {inside[0]}")
    for part in sorted(path.iterdir(), key=lambda part: part.name == "cluster.json"):
        if part.is_dir():
            shutil.rmtree(part)
        else:
            part.unlink()
    path.rmdir()
