"""Debian packages: installed ones from dpkg's database, and those that were only unpacked."""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from tools.sbom.parts import UNKNOWN, Part

_FIELD = re.compile(r"^([\w-]+): (.*)$", re.MULTILINE)
_LICENCE = re.compile(r"^License:[ \t]*(\S.*)$", re.MULTILINE)
_COMMON = re.compile(r"/usr/share/common-licenses/([\w.-]*\w)")
_CHANGE = re.compile(r"\S+ \((?P<version>[^)]+)\)")


def read_status(text: str, copyrights: Mapping[str, str]) -> Iterator[Part]:
    """Yield the installed packages of a dpkg database.

    Args:
        text: one paragraph for each package, as in /var/lib/dpkg/status.
        copyrights: package -> its copyright file.
    """
    for paragraph in re.split(r"\n\s*\n", text):
        fields = dict(_FIELD.findall(paragraph))
        if "Package" in fields and fields.get("Status", "installed").endswith("installed"):
            name = fields["Package"]
            yield Part("deb", name, fields["Version"], name_licences(copyrights.get(name, "")))


def name_licences(text: str) -> str:
    """Return the licences that a copyright file names, by Debian's names for them.

    A file in free text names at least the licences whose texts all Debian machines have.
    """
    machine_readable = "copyright-format/1.0" in text or "dep5" in text.lower()
    found = (_LICENCE if machine_readable else _COMMON).findall(text)
    return ", ".join(sorted({name.strip() for name in found})) or UNKNOWN


def read_unpacked(prefix: Path, name: str) -> Part:
    """Return a package that was unpacked below a directory and never installed."""
    place = prefix / "usr/share/doc" / name
    version = UNKNOWN
    for changes in sorted(place.glob("changelog*.gz")):
        if found := _CHANGE.match(gzip.decompress(changes.read_bytes()).decode("utf-8", "replace")):
            version = found["version"]
            break
    copyright_file = place / "copyright"
    text = copyright_file.read_text("utf-8", "replace") if copyright_file.exists() else ""
    return Part("deb", name, version, name_licences(text))
