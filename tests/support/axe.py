"""axe-core, which finds what keeps people with a keyboard or a screen reader from using a page."""

from __future__ import annotations

import functools
import hashlib
import io
import os
import tarfile
import urllib.request
from pathlib import Path
from typing import Any

from .browser import Tab

#: The archive of npm's package `axe-core`, below a registry, and the sum of the file in it.
ARCHIVE, FILE = "axe-core/-/axe-core-4.14.1.tgz", "package/axe.min.js"
SHA256 = "29348999450cdf2849a8e70b7912fc2da85a849da39c0d0d5394f51d4a9ed95c"
KEPT = Path.home() / ".cache" / "rigel-k8s" / "npm" / "axe.js"


@functools.cache
def read_axe() -> str:
    """Return axe's program; it is fetched once, and kept."""
    if not KEPT.is_file():
        registry = os.environ.get("NPM_CONFIG_REGISTRY", "https://registry.npmjs.org")
        with urllib.request.urlopen(f"{registry.rstrip('/')}/{ARCHIVE}", timeout=60) as answer:
            packed = io.BytesIO(answer.read())
        with tarfile.open(fileobj=packed) as archive:
            file = archive.extractfile(FILE)
            assert file
            program = file.read()
        KEPT.parent.mkdir(parents=True, exist_ok=True)
        beside = KEPT.with_name(f"axe.js.{os.getpid()}")  # several processes may do this at once
        beside.write_bytes(program)
        beside.replace(KEPT)
    text = KEPT.read_bytes()
    assert hashlib.sha256(text).hexdigest() == SHA256
    return text.decode()


def find_violations(tab: Tab) -> list[dict[str, Any]]:
    """Return what axe finds in a page, serious or critical: each with its rule and its places."""
    tab.read(f"{read_axe()}; true")
    found: list[dict[str, Any]] = tab.read("axe.run(document).then((found) => found.violations)")
    return [
        {"rule": one["id"], "help": one["help"], "at": [node["html"] for node in one["nodes"]]}
        for one in found
        if one["impact"] in ("serious", "critical")
    ]
