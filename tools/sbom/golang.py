"""The modules in compiled Go programs, and their licences from the module cache."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path

import attrs

from tools.sbom.licences import recognize_directory
from tools.sbom.parts import Part

_CAPITAL = re.compile(r"[A-Z]")


def read_programs(go: str, programs: Iterable[Path]) -> str:
    """Return the output of `go version -m` for programs."""
    command = [go, "version", "-m", *map(str, programs)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def read_modules(text: str) -> Iterator[Part]:
    """Yield the modules in the output of `go version -m`; a replaced one as its replacement."""
    waiting: Part | None = None
    for line in text.splitlines():
        words = line.split()
        if line.startswith("\t=>") and len(words) > 2:
            waiting = Part("golang", words[1], words[2])
            continue
        if waiting:
            yield waiting
            waiting = None
        if re.match(r"\t(mod|dep)\t", line) and len(words) > 2 and words[2] != "(devel)":
            waiting = Part("golang", words[1], words[2])
        elif found := re.match(r"\S.*: go(?P<version>\d[\w.]*)$", line):
            yield Part("golang", "std", found["version"], "BSD-3-Clause")
    if waiting:
        yield waiting


def add_licences(parts: Iterable[Part], cache: Path) -> Iterator[Part]:
    """Yield the modules with the licences from Go's module cache."""
    for part in parts:
        if part.name == "std":
            yield part
        else:
            directory = cache / f"{escape(part.name)}@{escape(part.version)}"
            yield attrs.evolve(part, licence=recognize_directory(directory))


def escape(name: str) -> str:
    """Return a module's path or version as the module cache spells it, without capitals."""
    return _CAPITAL.sub(lambda found: f"!{found[0].lower()}", name)
