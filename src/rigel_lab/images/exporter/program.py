"""The exporter's files as they are in its image, and the few of /etc that Debian's setup makes."""

from __future__ import annotations

from importlib.resources import files

from rigel_k8s.system.oci import Entry
from rigel_lab.images.base.program import ETC, PREFIX

#: In-pod scripts that the exporter imports.
_SCRIPTS = ("__init__.py", "interfaces.py", "rosrpc.py", "rtps.py", "spdp.py")


def entries() -> tuple[Entry, ...]:
    """Return all files, sorted by path."""
    own = files("rigel_k8s")
    parts = ["__init__.py", *(f"inpod/{name}" for name in _SCRIPTS)]
    parts += [f"exporter/{p.name}" for p in (own / "exporter").iterdir() if p.name.endswith(".py")]
    program = (
        Entry(f"{PREFIX}/rigel_k8s/{part}", own.joinpath(*part.split("/")).read_bytes())
        for part in sorted(parts)
    )
    return (*ETC, *program)
