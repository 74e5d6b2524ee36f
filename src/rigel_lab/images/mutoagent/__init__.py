"""The image of Muto's agent: Debian's Python, this package and the wheels that it needs."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

from rigel_k8s import __version__
from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import Entry, architecture, layer
from rigel_lab.images.base import wheels
from rigel_lab.images.base.build import EPOCH, BaseImage
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.program import ETC, PREFIX, ProgramImage

#: All but the lab: what the agent deploys has parts of each.
HOUSES = (
    *("rigel_build", "rigel_exporter", "rigel_gate", "rigel_graph", "rigel_inpod"),
    *("rigel_k8s", "rigel_multus", "rigel_muto", "rigel_rmw", "rigel_stack"),
)
PYTHON = "3.11"
#: The processors of images, as wheels name them.
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
#: The packages are not set up: one file of all authorities, where OpenSSL looks for it.
AUTHORITIES = (
    'mkdir -p "$1/etc/ssl/certs"; cat "$1"/usr/share/ca-certificates/mozilla/*.crt'
    ' > "$1/etc/ssl/certs/ca-certificates.crt"'
)

IMAGE = ProgramImage(
    name="muto-agent",
    title="image of Muto's agent",
    module="rigel_k8s",
    arguments=["--help"],
    environment=["SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt"],
    packages=["ca-certificates"],
)
REFERENCE, UPSTREAM = IMAGE.reference, IMAGE.upstream


def build(report: Reporter, *, arch: str | None = None, force: bool = False) -> BaseImage:
    """Return the image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        arch: the architecture of its programs (`arm64`); None: that of this machine.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap or pip is missing and cannot be installed here.
        CommandFailed: mmdebstrap or pip failed.
    """
    locked = read_lock().encode()
    arch = arch or architecture()
    prepare = partial(_prepare, MACHINES[arch])
    recipe = IMAGE.make_recipe(list_package(), arch=arch, locked=locked, prepare=prepare)
    return build_recipe(recipe, report, force=force)


def _prepare(machine: str, scratch: Path, report: Reporter) -> Sequence[str]:
    """Return mmdebstrap's hooks that put the wheels in, and the authorities."""
    platforms = [f"{kind}_{machine}" for kind in ("manylinux2014", "manylinux_2_28")]
    fetched = wheels.fetch(
        read_lock(),
        scratch / "wheels",
        report,
        what="Muto's agent",
        python=PYTHON,
        platforms=platforms,
    )
    tree = scratch / "wheels.tar"
    tree.write_bytes(layer(list_wheels(fetched), mtime=EPOCH))
    return (f"--extract-hook=tar-in {tree} /", f"--extract-hook={AUTHORITIES}")


def read_lock() -> str:
    """Return the wheels as a requirements file, each with its digests."""
    text = files("rigel_lab.images.mutoagent") / "files" / "wheels.txt"
    return text.read_text("utf-8")


def list_package() -> tuple[Entry, ...]:
    """Return this distribution's files, sorted by path, and the few of /etc."""
    found = [entry for house in HOUSES for entry in _walk(files(house), f"{PREFIX}/{house}")]
    # Its commands and job types are found by the entry points of an installed distribution.
    lines = (distribution("rigel-k8s").read_text("entry_points.txt") or "").splitlines()
    known = [line for line in lines if "=" not in line or find_house(line) in HOUSES]
    entries = "\n".join(known)
    named = f"Metadata-Version: 2.1\nName: rigel-k8s\nVersion: {__version__}\n"
    for name, text in (("METADATA", named), ("entry_points.txt", entries)):
        path = f"{PREFIX}/rigel_k8s-{__version__}.dist-info/{name}"
        found.append(Entry(path, text.encode()))
    return (*ETC, *sorted(found, key=lambda entry: entry.path))


def find_house(entry: str) -> str:
    """Return the house that an entry point's line leads to, `name = package.module:Object`."""
    return re.split(r"[.:]", entry.partition("=")[2].strip())[0]


def list_wheels(wheels: Iterable[Path]) -> Iterator[Entry]:
    """Yield the modules of wheels; their scripts are left out."""
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as opened:
            for info in opened.infolist():
                if not info.is_dir() and ".data/" not in info.filename:
                    yield Entry(f"{PREFIX}/{info.filename}", opened.read(info))


def _walk(directory: Any, path: str) -> Iterator[Entry]:
    for item in directory.iterdir():
        below = f"{path}/{item.name}"
        if item.is_dir():
            if item.name != "__pycache__":
                yield from _walk(item, below)
        else:
            yield Entry(below, item.read_bytes())
