"""Write a list of components.

usage: python -m tools.sbom wheel            the wheel's SBOM: requirements/run.txt, tools/npm.py
       python -m tools.sbom image ARCHIVE    an image's, from the archive that `rigel image` keeps
       python -m tools.sbom cluster          the local cluster's programs'
       python -m tools.sbom licences         write docs/licences.md, from the same programs

SBOMs are CycloneDX 1.6 JSON on standard output.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

from cyclonedx.model.component import ComponentType

from rigel_k8s import __version__
from tools.npm import DAGRE
from tools.sbom.archive import read_archive
from tools.sbom.cluster import read_cluster, write_page
from tools.sbom.document import write_document
from tools.sbom.parts import Part
from tools.sbom.requirements import read_library, read_requirements

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "licences.md"


def main(arguments: Sequence[str]) -> int:
    """Run one of the commands; return the exit code."""
    parts: Iterator[Part]
    match arguments:
        case ["wheel"]:
            lock = (ROOT / "requirements" / "run.txt").read_text("utf-8")
            parts = chain(read_requirements(lock), [read_library(DAGRE)])
            text = write_document("rigel-k8s", __version__, ComponentType.APPLICATION, parts)
        case ["image", path]:
            archive = Path(path)
            parts = iter(read_archive(archive))
            name = f"{archive.parent.name}/{archive.stem}"
            text = write_document(name, __version__, ComponentType.CONTAINER, parts)
        case ["cluster"]:
            parts = (part for found in read_cluster().values() for part in found)
            text = write_document("local-cluster", __version__, ComponentType.PLATFORM, parts)
        case ["licences"]:
            PAGE.write_text(write_page(read_cluster()), "utf-8")
            return 0
        case _:
            sys.stderr.write(__doc__ or "")
            return 2
    sys.stdout.write(f"{text}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
