"""The exporter's files as they are in its image, and the few of /etc that Debian's setup makes."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from rigel_k8s.system.oci import Entry
from rigel_lab.images.base.program import ETC, PREFIX

#: In-pod scripts that the exporter imports.
_SCRIPTS = ("__init__.py", "interfaces.py", "rosrpc.py", "rtps.py", "spdp.py")


def entries() -> tuple[Entry, ...]:
    """Return all files, sorted by path."""
    parts = [files("rigel_inpod") / name for name in _SCRIPTS]
    parts += [p for p in files("rigel_exporter").iterdir() if p.name.endswith(".py")]
    program = sorted(
        (
            Entry(f"{PREFIX}/{path.parent.name}/{path.name}", path.read_bytes())
            for path in map(Path, map(str, parts))
        ),
        key=lambda entry: entry.path,
    )
    return (*ETC, *program)
