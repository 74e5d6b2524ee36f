"""The end of a cluster: all that it made is removed, in whatever state it is."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from pathlib import Path

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster import cgroups, kubeconfig, machine, network, shared
from rigel_lab.cluster.commands import Report
from rigel_lab.cluster.paths import boot_id, names
from rigel_lab.cluster.state import State

#: What is mounted where, for this process.
MOUNTS = Path("/proc/self/mountinfo")
#: Files that are deleted at once.
WIDTH = 16


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
            delete(part)
        else:
            part.unlink()
    path.rmdir()


def delete(directory: Path) -> None:
    """Delete a directory with all in it, many files at once.

    Where a disk is mounted with `discard`, each deletion waits for it: one after the other, the
    files of a cluster take minutes.
    """
    folders, files = [str(directory)], list[str]()
    for folder in folders:  # grows meanwhile
        with os.scandir(folder) as found:
            for one in found:
                (folders if one.is_dir(follow_symlinks=False) else files).append(one.path)
    _call_for_all(os.unlink, files)
    for _, level in groupby(reversed(folders), key=lambda folder: folder.count("/")):
        _call_for_all(os.rmdir, list(level))


def _call_for_all(call: Callable[[str], None], paths: Sequence[str]) -> None:
    def call_some(first: int) -> None:
        for path in paths[first::WIDTH]:
            call(path)

    with ThreadPoolExecutor(WIDTH) as pool:
        list(pool.map(call_some, range(min(WIDTH, len(paths)))))
