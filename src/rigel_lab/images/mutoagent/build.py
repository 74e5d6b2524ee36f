"""The recipe of the agent's image."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import architecture, layer
from rigel_lab.images.base import wheels
from rigel_lab.images.base.build import EPOCH, BaseImage
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.program import ProgramImage
from rigel_lab.images.mutoagent.program import list_package, list_wheels, read_lock

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
