"""A few files and links as an image's layer; pure: the same input gives the same bytes."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterable
from importlib.resources import files

import attrs

__all__ = ["ENTRYPOINT", "Entry", "config", "layer"]


@attrs.frozen
class Entry:
    """One file or symbolic link of the layer; `link` is the target of a link."""

    path: str
    content: bytes = b""
    link: str = ""
    mode: int = 0o644


#: The script that official ROS images start everything with.
ENTRYPOINT = Entry(
    "ros_entrypoint.sh",
    (files("rigel_lab.images.base") / "files" / "ros_entrypoint.sh").read_bytes(),
    mode=0o755,
)


def config(distro: str) -> dict[str, list[str]]:
    """Return an image's configuration; LANG as in the official image, so Python writes UTF-8."""
    return {
        "Entrypoint": ["/ros_entrypoint.sh"],
        "Cmd": ["bash"],
        "Env": [
            "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
            "LANG=C.UTF-8",
            "LC_ALL=C.UTF-8",
            f"ROS_DISTRO={distro}",
        ],
    }


def layer(entries: Iterable[Entry], *, mtime: int) -> bytes:
    """Return the layer as an uncompressed tar, the entries as they come."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for entry in entries:
            tar.addfile(_member(entry, mtime), io.BytesIO(entry.content))
    return out.getvalue()


def _member(entry: Entry, mtime: int) -> tarfile.TarInfo:
    info = tarfile.TarInfo(entry.path)
    info.mtime = mtime
    info.mode = entry.mode
    info.size = len(entry.content)
    if entry.link:
        info.type, info.linkname, info.mode = tarfile.SYMTYPE, entry.link, 0o777
    return info
