"""The wheel's requirements, from the lock file that `./run` installs."""

from __future__ import annotations

import re
from collections.abc import Iterator

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
