"""Where clusters keep their state."""

from __future__ import annotations

from pathlib import Path

#: One directory for each cluster in `clusters`, and what several clusters share.
STATE = Path("/var/lib/rigel-k8s")
LOCKS = Path("/run/rigel-k8s")


def directory_of(name: str) -> Path:
    """Return where a cluster keeps its state."""
    return STATE / "clusters" / name


def names() -> list[str]:
    """Return the names of all local clusters."""
    found = (STATE / "clusters").glob("*/cluster.json")
    return sorted(path.parent.name for path in found)


def boot_id() -> str:
    """Return an id that changes with every boot of this machine."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
