"""The cgroups of a cluster's nodes, on cgroup v1 and v2; independent of processes."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

from rigel_k8s.errors import LocalClusterError

ROOT = Path("/sys/fs/cgroup")


def roots() -> list[Path]:
    """Return the places for the cgroups of all controllers: many on v1, one on v2."""
    if (ROOT / "cgroup.controllers").exists():
        return [ROOT]
    return [p for p in ROOT.iterdir() if p.is_dir() and not p.is_symlink() and p.name != "unified"]


def create(cluster: str, node: str) -> str:
    """Make a node's cgroup in every controller and return its path from the root.

    Raises:
        LocalClusterError: cgroups are read-only here (an unprivileged container).
    """
    for root in roots():
        for path in (root / f"rigel-{cluster}", root / f"rigel-{cluster}" / node):
            try:
                path.mkdir(exist_ok=True)
                prepare(root, path)
            except OSError as error:
                raise LocalClusterError(
                    f"cannot make the cgroup {path}: {error.strerror}",
                    hint="make cgroups writable; run a container privileged",
                ) from error
    return f"/rigel-{cluster}/{node}"


def prepare(root: Path, path: Path) -> None:
    """Let a new cgroup use what its parent has: cpuset on v1, every controller on v2."""
    if root.name == "cpuset":
        for key in ("cpuset.cpus", "cpuset.mems"):
            (path / key).write_text((path.parent / key).read_text())
    if (path.parent / "cgroup.subtree_control").exists():
        for controller in (path.parent / "cgroup.controllers").read_text().split():
            with suppress(OSError):
                (path.parent / "cgroup.subtree_control").write_text(f"+{controller}")


def remove(cluster: str, node: str = "", *, seconds: float = 15) -> None:
    """Remove the cgroups of a cluster, or of one node of it, whose processes have ended.

    Raises:
        LocalClusterError: one still has processes.
    """
    deadline = time.monotonic() + seconds
    # containerd makes cgroups in the v2 hierarchy beside v1 too.
    tops = [root / f"rigel-{cluster}" / node for root in [*roots(), ROOT / "unified"]]
    while left := [top for top in tops if top.exists()]:
        for top in left:
            for path in sorted([p for p in top.rglob("*") if p.is_dir()], reverse=True) + [top]:
                with suppress(OSError):
                    path.rmdir()
        if time.monotonic() > deadline:
            raise LocalClusterError(
                f"cannot remove the cgroup {left[0]}: it still has processes",
                hint=f"find them in {left[0]}/**/cgroup.procs",
            )
        time.sleep(0.02)
