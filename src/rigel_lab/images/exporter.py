"""The ROS exporter's image: Debian's Python and the exporter, nothing else and no shell."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import Entry
from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.program import ETC, PREFIX, ProgramImage

IMAGE = ProgramImage(
    name="ros-exporter",
    title="ROS exporter's image",
    module="rigel_exporter",
    arguments=["/etc/ros-exporter/config.json"],
)
REFERENCE, UPSTREAM = IMAGE.reference, IMAGE.upstream
#: In-pod scripts that the exporter imports.
SCRIPTS = ("__init__.py", "interfaces.py", "rosrpc.py", "rtps.py", "spdp.py")


def build(report: Reporter, *, arch: str | None = None, force: bool = False) -> BaseImage:
    """Return the image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        arch: the architecture of its programs (`arm64`); None: that of this machine.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap is missing and cannot be installed here.
        CommandFailed: mmdebstrap failed.
    """
    return build_recipe(IMAGE.make_recipe(entries(), arch=arch), report, force=force)


def entries() -> tuple[Entry, ...]:
    """Return the program's files, sorted by path, and the few of /etc that Debian's setup makes."""
    parts = [files("rigel_inpod") / name for name in SCRIPTS]
    parts += [p for p in files("rigel_exporter").iterdir() if p.name.endswith(".py")]
    program = sorted(
        (
            Entry(f"{PREFIX}/{path.parent.name}/{path.name}", path.read_bytes())
            for path in map(Path, map(str, parts))
        ),
        key=lambda entry: entry.path,
    )
    return (*ETC, *program)
