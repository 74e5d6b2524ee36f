"""Debian packages to a root file system, by mmdebstrap; independent of ROS and of images."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from rigel_k8s.errors import CommandFailed, RigelK8sError
from rigel_k8s.report import Reporter
from rigel_k8s.system.process import run, stream

#: Debian's essential packages and apt, in addition to the requested ones.
MINBASE = "minbase"

#: Unpacks packages and their dependencies, and sets nothing up: no shell, no apt.
EXTRACT = "extract"

_KEY = "root file system"
#: Seconds that mmdebstrap has to remove its mounts and its scratch directory.
_GRACE = 60.0

#: Manuals and translations: 80 MB that no container reads.
_LEAVE_OUT = (
    "/usr/share/doc/*",
    "/usr/share/info/*",
    "/usr/share/locale/*",
    "/usr/share/man/*",
    "/usr/share/cmake-*/Help/*",
)
#: `extract` leaves dpkg's database empty. This records the packages the way that distroless images
#: do, in the directory where scanners of images look for it.
RECORD = (
    'mkdir -p "$1/var/lib/dpkg/status.d"; for deb in "$1"/var/cache/apt/archives/*.deb; do '
    'dpkg-deb -f "$deb" > "$1/var/lib/dpkg/status.d/$(dpkg-deb -f "$deb" Package)" || exit; done'
)


def bootstrap(
    suite: str,
    packages: Sequence[str],
    target: Path,
    report: Reporter,
    *,
    mtime: int,
    hooks: Sequence[str] = (),
    variant: str = MINBASE,
    arch: str,
) -> None:
    """Write a Debian root file system with these packages to `target`, an uncompressed tar.

    Args:
        suite: the Debian release.
        packages: their dependencies are added, recommended ones are not.
        target: the tar to write.
        report: shows the progress.
        mtime: seconds since 1970, the latest time that a file gets.
        hooks: options of mmdebstrap that change the root file system after its packages are in.
        variant: mmdebstrap's, MINBASE or EXTRACT.
        arch: of the programs; another one than this machine's needs qemu-user-static.

    Raises:
        CommandFailed: mmdebstrap failed; carries its last lines.
    """
    ensure_mmdebstrap(report)
    command = _command(suite, packages, target, hooks, variant, arch)

    def show(line: str) -> None:
        if line.startswith("I: "):  # mmdebstrap's own words; the rest is apt's
            report.progress(_KEY, line[3:].strip())

    try:
        stream(
            command,
            what="building the root file system with mmdebstrap",
            hint="check that Debian's archive can be reached (http_proxy is honoured) and retry",
            env={**os.environ, "SOURCE_DATE_EPOCH": str(mtime), "LC_ALL": "C.UTF-8"},
            on_line=show,
            grace=_GRACE,
        )
    except CommandFailed:
        target.unlink(missing_ok=True)
        raise
    report.progress(_KEY, "done", done=True)


def ensure_mmdebstrap(report: Reporter) -> None:
    """Install Debian's mmdebstrap if it is missing.

    Raises:
        RigelK8sError: it is missing and cannot be installed here.
    """
    if shutil.which("mmdebstrap"):
        return
    if os.geteuid() != 0 or not shutil.which("apt-get"):
        raise RigelK8sError(
            "mmdebstrap, which builds the base image, is not installed",
            hint="install it (Debian, Ubuntu: sudo apt-get install mmdebstrap) and retry",
        )
    report.line("installing the Debian package mmdebstrap (builds the root file system)")
    _apt("update", "-q")
    _apt("install", "-q", "-y", "--no-install-recommends", "mmdebstrap", "debian-archive-keyring")


def _command(
    suite: str,
    packages: Sequence[str],
    target: Path,
    hooks: Sequence[str],
    variant: str,
    arch: str,
) -> list[str]:
    return [
        "mmdebstrap",
        f"--architectures={arch}",
        f"--variant={variant}",
        # Links /bin to /usr/bin before the first package, for usr-is-merged.
        "--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr",
        *(f"--dpkgopt=path-exclude={pattern}" for pattern in _LEAVE_OUT),
        "--dpkgopt=path-include=/usr/share/doc/*/copyright",
        f"--include={','.join(packages)}",
        *([f"--extract-hook={RECORD}"] if variant == EXTRACT else ()),
        *hooks,
        suite,
        str(target),
    ]


def _apt(*args: str) -> None:
    command = ["apt-get", "-o", "DPkg::Lock::Timeout=300", *args]
    run(
        command,
        what=" ".join(command),
        hint="run it by hand to see why, then retry",
        env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"},
        timeout=900,
    )
