"""The recipe of the ROS 2 base image: Debian, the wheels, and the official image's paths.

The wheels contain what a ROS installation contains, below `NAME.data/data`. So they are unpacked,
not installed: pip's own place for them needs each program started twice, with an LD_LIBRARY_PATH of
a dozen directories. What only compilers read is left out.
"""

from __future__ import annotations

import io
import re
import tarfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import attrs

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import Entry, architecture, layer
from rigel_lab.images.base.build import EPOCH, BaseImage, Recipe
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.layer import ENTRYPOINT, config
from rigel_lab.images.base.wheels import fetch as fetch_wheels
from rigel_lab.images.ros2base.packages import (
    PACKAGES,
    PLATFORM,
    PYTHON,
    REFERENCES,
    SUITE,
    Distro,
    lock,
)

_SETUP = ("setup.bash", "setup.sh", "setup.zsh")

#: Where Python looks below the prefix.
SITE = f"lib/python{PYTHON}/site-packages"

#: Where wheels keep the bundled libraries that they need; their names end in a digest.
_BUNDLED = re.compile(r"ros_\w+\.libs/(?P<name>.+)")
_DATA = re.compile(r"[^/]+\.data/data/(?P<path>.+)")
_LEFT_OUT = re.compile(r"(^|/)include/|(^|/)cmake/|\.a$|(^|/)_dummy\.[^/]+\.so$|^bin/nodesize_dbg$")
_LIBRARY = re.compile(r"lib/lib[^/]+\.so[.0-9]*")


def build(report: Reporter, *, distro: Distro = "jazzy", force: bool = False) -> BaseImage:
    """Return the base image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        distro: the ROS 2 distribution.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap or pip is missing, or no wheels exist for this processor.
        CommandFailed: mmdebstrap or pip failed.
    """
    if architecture() != "amd64":
        raise RigelK8sError(
            f"there are no wheels of ROS 2 for {architecture()}, only for {PLATFORM}",
            hint="build the image on an amd64 machine, or use the official one if you can reach it",
        )
    return build_recipe(_recipe(distro), report, force=force)


def _recipe(distro: Distro) -> Recipe:
    def prepare(scratch: Path, report: Reporter) -> Sequence[str]:
        fetched = fetch(lock(distro), scratch / "wheels", report)
        ros = scratch / "ros.tar"
        write_tree(fetched, prefix(distro), ros, mtime=EPOCH)
        # Compiled, since pods start with a read-only or an empty cache.
        compiled = "python3 -m compileall -q --invalidation-mode checked-hash"
        return (
            f"--customize-hook=tar-in {ros} /",
            f'--customize-hook=chroot "$1" {compiled} /{prefix(distro)}/{SITE}',
        )

    return Recipe(
        title="ROS 2 base image",
        family="ros2-base",
        name=distro,
        reference=REFERENCES[distro],
        suite=SUITE,
        packages=PACKAGES,
        config=config(distro),
        overlay=layer(list_files(distro), mtime=EPOCH),
        locked=lock(distro).encode(),
        prepare=prepare,
    )


def prefix(distro: Distro) -> str:
    """Return the place of ROS, relative to the root."""
    return f"opt/ros/{distro}"


def list_files(distro: Distro) -> tuple[Entry, ...]:
    """Return the files that neither Debian nor the wheels have: a layer, sorted by path."""
    own = files("rigel_lab.images.ros2base") / "files"
    where = prefix(distro)

    def script(name: str) -> bytes:
        return (own / name).read_bytes().replace(b"@DISTRO@", distro.encode())

    scripts = (Entry(f"{where}/{name}", script(name)) for name in _SETUP)
    command = Entry(f"{where}/bin/ros2", script("ros2.sh"), mode=0o755)
    parts = (
        Entry(f"{where}/share/rigel_ros2/{part.name}", part.read_bytes())
        for part in (own / "ros2").iterdir()
        if part.name.endswith(".py")
    )
    return tuple(sorted((ENTRYPOINT, command, *scripts, *parts), key=lambda e: e.path))


@attrs.frozen
class _Part:
    """One file of the tree; `link` is the name beside it with the same content."""

    wheel: Path
    member: str
    size: int
    crc: int
    link: str = ""


def fetch(lock: str, directory: Path, report: Reporter) -> list[Path]:
    """Download ROS 2's wheels. Raises as images.base.wheels."""
    return fetch_wheels(lock, directory, report, what="ROS 2", python=PYTHON, platforms=(PLATFORM,))


def write_tree(wheels: Iterable[Path], prefix: str, target: Path, *, mtime: int) -> None:
    """Write the wheels' content below `prefix` to an uncompressed tar.

    Raises:
        RigelK8sError: two wheels disagree about a file.
    """
    parts = _add_links(_parts(wheels))
    with tarfile.open(target, "w", format=tarfile.PAX_FORMAT) as tar:
        for path, part in sorted(parts.items()):
            info = tarfile.TarInfo(f"{prefix}/{path}")
            info.mtime = mtime
            if part.link:
                info.type, info.linkname, info.mode = tarfile.SYMTYPE, part.link, 0o777
                tar.addfile(info)
                continue
            info.size, info.mode = part.size, 0o755 if path.startswith("bin/") else 0o644
            with zipfile.ZipFile(part.wheel) as wheel:
                tar.addfile(info, io.BytesIO(wheel.read(part.member)))


def _parts(wheels: Iterable[Path]) -> dict[str, _Part]:
    found: dict[str, _Part] = {}
    for path, part in (both for wheel in wheels for both in _members(wheel)):
        other = found.setdefault(path, part)
        if (other.crc, other.size) != (part.crc, part.size):
            raise RigelK8sError(
                f"{part.wheel.name} and {other.wheel.name} have different files {path}",
                hint="the wheels' versions do not match: renew the lock file",
            )
    return found


def _members(wheel: Path) -> Iterator[tuple[str, _Part]]:
    """Yield the places of a wheel's files below the prefix."""
    with zipfile.ZipFile(wheel) as opened:
        for info in opened.infolist():
            path = _place(info.filename)
            if not info.is_dir() and not _LEFT_OUT.search(path):
                yield path, _Part(wheel, info.filename, info.file_size, info.CRC)


def _place(member: str) -> str:
    """Return a member's path below the prefix; bundled libraries join ROS's own."""
    if found := _DATA.fullmatch(member):
        return found["path"]
    if found := _BUNDLED.fullmatch(member):
        return f"lib/{found['name']}"
    return f"{SITE}/{member}"


def _add_links(parts: Mapping[str, _Part]) -> dict[str, _Part]:
    """Return the parts with a library's shorter names as links, which wheels cannot contain."""
    longest: dict[tuple[int, int], str] = {}
    for path in sorted(filter(_LIBRARY.fullmatch, parts), key=len):
        longest[parts[path].crc, parts[path].size] = path
    made = dict(parts)
    for path, part in parts.items():
        real = longest.get((part.crc, part.size), path)
        if _LIBRARY.fullmatch(path) and real != path and real.startswith(path):
            made[path] = attrs.evolve(part, link=real.rpartition("/")[2])
    return made
