"""The wheel's requirements, from the lock file that `./run` installs, and what is bundled in it."""

from __future__ import annotations

import re
from collections.abc import Iterator

from tools.npm import Package
from tools.sbom.parts import Part

_ENTRY = re.compile(
    r"^(?P<name>[\w.-]+)==(?P<version>[^\s;]+)(?P<rest>(?:.*\\\n)*.*)$", re.MULTILINE
)
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")


def read_requirements(lock: str) -> Iterator[Part]:
    """Yield the packages that a requirements file with hashes pins."""
    for found in _ENTRY.finditer(lock):
        hashes = tuple(_HASH.findall(found["rest"]))
        yield Part("pypi", found["name"].lower(), found["version"], sha256=hashes)


def read_library(package: Package) -> Part:
    """Return an npm package whose files are in the wheel; the digests are those of its files."""
    digests = tuple(file.sha256 for file in package.files)
    return Part("npm", package.name, package.version, package.licence, digests)
