"""Fetch what comes from npm: pinned files of packages, each with the hash that npm publishes.

usage: python tools/npm.py    put the library that draws graphs into the package (`rigel ui`)

It is also hatchling's build hook, by which the library is in every wheel. It needs neither node nor
npm, nothing but Python, and takes the registry from where npm does: $npm_config_registry,
`registry` or `@SCOPE:registry` in .npmrc here or at home. A registry that asks for a login is not
supported.
"""

from __future__ import annotations

import base64
import hashlib
import io
import os
import sys
import tarfile
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    Hook = object
else:
    try:
        from hatchling.builders.hooks.plugin.interface import BuildHookInterface as Hook
    except ImportError:  # as a program, it needs no build backend
        Hook = object

ROOT = Path(__file__).parents[1]
PUBLIC = "https://registry.npmjs.org"
#: Set to 1, it lets a wheel be built without `rigel ui`.
WITHOUT = "RIGEL_WITHOUT_UI"
TIMEOUT = 60.0  # seconds without a byte
LARGEST = 64 * 1024 * 1024  # bytes of a package


class File(NamedTuple):
    """A file of a package: its path there, what it is called here, and its sum."""

    path: str
    name: str
    sha256: str


class Package(NamedTuple):
    """A version of an npm package.

    Attributes:
        integrity: of its archive, as npm publishes it (`npm view NAME dist.integrity`).
        licence: its SPDX identifier.
        files: its files that are used.
    """

    name: str
    version: str
    integrity: str
    licence: str
    files: tuple[File, ...]

    @property
    def path(self) -> str:
        """Where a registry has its archive."""
        return f"{self.name}/-/{self.name.rpartition('/')[2]}-{self.version}.tgz"


#: What lays out the graph of `rigel ui`; it contains @dagrejs/graphlib, of the same licence.
DAGRE = Package(
    "@dagrejs/dagre",
    "3.1.3",
    "sha512-X4aUTwOReZvthaZWOVHqlJ52/ZdhZFEM4+Lh/uR4XooUSLE6p71bcy7MPGzYnNUcNh+nj+i/qJQpCMIdQnSmrg==",
    "MIT",
    (
        File(
            "dist/dagre.esm.js",
            "dagre.js",
            "b0ddaf4af1417bec9bd89373a3a3987f081727d6cc6d95fc40dbf85a19bdf3b0",
        ),
        File(
            "LICENSE",
            "dagre.LICENSE",
            "6a349742a6cb219d5a2fc8d0844f6d89a6efc62e20c664450d884fc7ff2d6015",
        ),
    ),
)
#: What the tests ask whether a page is accessible; it is in no wheel.
AXE = Package(
    "axe-core",
    "4.14.1",
    "sha512-FHfa+lmNjQZfJz1q8wKqIDwC6DExcHt/pkjNQb09a3NPjCKg2rhu5qb2S4r76ASyFNNtuFooJpZe37OgudVGtQ==",
    "MPL-2.0",
    (
        File(
            "axe.min.js",
            "axe.js",
            "29348999450cdf2849a8e70b7912fc2da85a849da39c0d0d5394f51d4a9ed95c",
        ),
    ),
)
FOLDER = ROOT / "src" / "rigel_k8s" / "ui" / "page" / "lib"


class NotFetched(Exception):
    """A package is not available, or is not what was pinned."""


def install(package: Package, folder: Path) -> None:
    """Put a package's files into a folder, unless they are there unchanged.

    Raises:
        NotFetched: it is not available.
    """
    if all(is_pinned(folder / file.name, file) for file in package.files):
        return
    found = unpack(package, fetch(package))
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in found.items():
        beside = folder / f"{name}.{os.getpid()}"  # several processes may do this at once
        beside.write_bytes(content)
        beside.replace(folder / name)


def is_pinned(path: Path, file: File) -> bool:
    """Whether a file is there, and is the one that was pinned."""
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == file.sha256


def fetch(package: Package) -> bytes:
    """Return a package's archive from the registry, if it is the one that was pinned.

    Raises:
        NotFetched: it is not available.
    """
    registry = find_registry(package.name, os.environ, [ROOT, Path.home()])
    url = f"{registry.rstrip('/')}/{package.path}"
    if not url.startswith(("https://", "http://")):
        raise NotFetched(f"{registry} is not the address of an npm registry")
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT) as answer:
            content: bytes = answer.read(LARGEST)
    except OSError as error:
        raise NotFetched(
            f"cannot fetch {package.name} {package.version} from {url}: {error}"
        ) from error
    kind, _, expected = package.integrity.partition("-")
    found = base64.b64encode(hashlib.new(kind, content).digest()).decode()
    if found != expected:
        raise NotFetched(
            f"{url} is not {package.name} {package.version} as it was pinned: {kind}-{found}"
        )
    return content


def unpack(package: Package, archive: bytes) -> dict[str, bytes]:
    """Return the files of an archive that are used, by what they are called here."""
    found = {}
    with tarfile.open(fileobj=io.BytesIO(archive)) as opened:
        for file in package.files:
            entry = opened.extractfile(f"package/{file.path}")
            if entry is None:
                raise NotFetched(f"{package.name} {package.version} has no file {file.path}")
            found[file.name] = entry.read()
    return found


def find_registry(name: str, variables: Mapping[str, str], folders: list[Path]) -> str:
    """Return the registry of a package, as npm finds it.

    Args:
        variables: the environment.
        folders: where .npmrc may be, the most important first.
    """
    scope = f"{name.partition('/')[0]}:registry" if name.startswith("@") else ""
    files = [read_settings(folder / ".npmrc") for folder in folders]
    own = {
        key.lower().removeprefix("npm_config_"): value
        for key, value in variables.items()
        if key.lower().startswith("npm_config_") and value
    }
    for key in filter(None, (scope, "registry")):
        for settings in (own, *files):
            if settings.get(key):
                return settings[key]
    return PUBLIC


def read_settings(path: Path) -> dict[str, str]:
    """Return the settings of an .npmrc; none where there is no such file."""
    if not path.is_file():
        return {}
    lines = (line.partition("=") for line in path.read_text("utf-8").splitlines())
    return {
        key.strip(): value.strip() for key, sign, value in lines if sign and key[:1] not in "#;"
    }


class PageLibrary(Hook):
    """Hatchling's hook: the library is in every wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Fetch what is not there; only an editable installation goes on without it."""
        del build_data
        if os.environ.get(WITHOUT) == "1":
            return
        try:
            install(DAGRE, FOLDER)
        except NotFetched as error:
            if version != "editable":
                raise NotFetched(
                    f"{error}\n`rigel ui` needs it. Name a registry with $npm_config_registry, or"
                    f" build without `rigel ui`: {WITHOUT}=1"
                ) from error
            sys.stderr.write(f"warning: {error}; `rigel ui` needs it: python tools/npm.py\n")


def main() -> int:
    """Fetch the library; return the exit code."""
    try:
        install(DAGRE, FOLDER)
    except NotFetched as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
