"""Builds the layer, the library that rigel_rmw/layer.c describes, into the wheel.

Why here: pods need a compiled library, and whoever installs the package needs no compiler. ziglang,
a compiler from PyPI, makes it for both machines and for every glibc since 2.17, on any machine; the
wheel stays one for all platforms. The same sources and the same ziglang give the same bytes.

Without ziglang the package is built without the library, and `rigel check` says what that costs.
`python hatch_build.py` builds it for a checkout, as an editable installation does.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import subprocess
import sys
import tempfile
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

HOME = Path(__file__).parent / "src/rigel_rmw"
SOURCES = ("layer.c", "layer.h")
LIBRARIES = HOME / "lib"
MACHINES = ("x86_64", "aarch64")
WORDS = (
    *("-std=gnu11", "-Wall", "-Wextra", "-O2", "-fPIC", "-fexceptions"),
    *("-shared", "-fvisibility=hidden", "-s"),
)
#: What the libraries in the folder were made of.
STAMP = "made-of"


class CustomBuildHook(BuildHookInterface[Any]):
    """Called by hatchling before it collects the files of a wheel or an editable installation."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make the libraries, if there is a compiler."""
        if not build():
            self.app.display_warning("ziglang is not installed: the wheel has no library of ROS 2")


def build() -> bool:
    """Make the libraries unless those of these sources are there; return whether they are."""
    if importlib.util.find_spec("ziglang") is None:
        return False
    made_of = describe()
    stamp = LIBRARIES / STAMP
    if stamp.is_file() and stamp.read_text() == made_of:
        return True
    LIBRARIES.mkdir(exist_ok=True)
    for machine in MACHINES:
        compile_layer(machine)
    replace(stamp, made_of.encode())
    return True


def describe() -> str:
    """Return what the libraries depend on: the sources, the compiler and how it is called."""
    digest = hashlib.sha256(repr((WORDS, MACHINES)).encode())
    for name in SOURCES:
        digest.update((HOME / name).read_bytes())
    return f"ziglang {version_of('ziglang')} {digest.hexdigest()}\n"


def compile_layer(machine: str) -> None:
    """Make the library of one kind of machine.

    The compiler sees no path of this checkout, and keeps nothing of other builds.
    """
    with tempfile.TemporaryDirectory() as directory:
        made = Path(directory) / "layer.so"
        target = f"{machine}-linux-gnu.2.17"
        line = [sys.executable, "-m", "ziglang", "cc", "-target", target, *WORDS, "-o", str(made)]
        caches = {"ZIG_GLOBAL_CACHE_DIR": directory, "ZIG_LOCAL_CACHE_DIR": directory}
        subprocess.run(
            [*line, SOURCES[0], "-ldl", "-lpthread"], check=True, cwd=HOME, env=os.environ | caches
        )
        replace(LIBRARIES / f"rmw-{machine}.so", made.read_bytes())


def replace(path: Path, content: bytes) -> None:
    """Write a file at once: two builds may run beside each other."""
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    partial.write_bytes(content)
    partial.replace(path)


if __name__ == "__main__":
    sys.exit(None if build() else "ziglang is not installed")
