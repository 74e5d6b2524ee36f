"""The Debian and Python packages in the layers of an image's archive."""

from __future__ import annotations

import re
import tarfile
from collections.abc import Iterator
from email.parser import HeaderParser
from pathlib import Path

from rigel_k8s.system import oci
from tools.sbom.debian import read_status
from tools.sbom.parts import UNKNOWN, Part

_STATUS = re.compile(r"var/lib/dpkg/(status|status\.d/[^/]+)")
_COPYRIGHT = re.compile(r"usr/share/doc/(?P<package>[^/]+)/copyright")
_METADATA = re.compile(r".*/[^/]+\.dist-info/METADATA")


def read_archive(path: Path) -> list[Part]:
    """Return what is in an image, from its archive."""
    files: dict[str, str] = {}
    with tarfile.open(path) as archive:
        for layer in oci.read_archive(archive).layers:
            with layer.open() as stream, tarfile.open(fileobj=stream) as tar:
                files.update(_texts(tar))
    return sorted(set(read_files(files)))


def read_files(files: dict[str, str]) -> Iterator[Part]:
    """Yield the packages that an image's files record: path without a leading slash -> text."""
    copyrights = {m["package"]: text for p, text in files.items() if (m := _COPYRIGHT.fullmatch(p))}
    for path, text in files.items():
        if _STATUS.fullmatch(path):
            yield from read_status(text, copyrights)
        elif _METADATA.fullmatch(path) and not path.startswith("usr/lib/python3/dist-packages/"):
            yield read_metadata(text)  # those in dist-packages are Debian's


def read_metadata(text: str) -> Part:
    """Return a Python package from its metadata."""
    fields = HeaderParser().parsestr(text)
    licence = fields["License-Expression"] or fields["License"] or UNKNOWN
    return Part("pypi", fields["Name"].lower(), fields["Version"], licence.splitlines()[0].strip())


def _texts(tar: tarfile.TarFile) -> Iterator[tuple[str, str]]:
    for member in tar:
        name = member.name.removeprefix("./")
        wanted = _STATUS.fullmatch(name) or _COPYRIGHT.fullmatch(name) or _METADATA.fullmatch(name)
        if wanted and member.isfile() and (file := tar.extractfile(member)):
            yield name, file.read().decode("utf-8", "replace")
