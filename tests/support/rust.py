"""The node on RustDDS of tests/images/rustdds, built where the cache lacks it: a minute."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from pathlib import Path

from rigel_k8s.system.cache import cache_dir, locked

SOURCE = Path(__file__).parents[1] / "images" / "rustdds"
MACHINE = "x86_64-unknown-linux-gnu"
#: The first Cargo that knows the edition of all its crates.
CARGO = (1, 85)


class Missing(Exception):
    """There is no Cargo, or an old one."""


def rustdds_node() -> Path:
    """Return the program.

    Raises:
        Missing: it is to be built, and cannot be.
    """
    files = [SOURCE / "Cargo.toml", SOURCE / "Cargo.lock", SOURCE / "src" / "main.rs"]
    key = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]
    cache = cache_dir() / "test-images"
    built = cache / f"rustdds-node-{key}"
    with locked(built.with_suffix(".lock")):
        if not built.exists():
            shutil.copy(build(cache / "rustdds"), built)
    return built


def build(target: Path) -> Path:
    """Build it with the machine's Cargo, without shared libraries."""
    cargo = shutil.which("cargo")
    if not cargo or version(cargo) < CARGO:
        raise Missing("no cargo 1.85 or newer, which would build the node on RustDDS")
    words = ["build", "--quiet", "--locked", "--target", MACHINE, "--target-dir", str(target)]
    done = subprocess.run(
        [cargo, *words, "--manifest-path", str(SOURCE / "Cargo.toml")],
        env={**os.environ, "RUSTFLAGS": "-C target-feature=+crt-static"},
        capture_output=True,
        text=True,
        check=False,
        timeout=1800,
    )
    assert done.returncode == 0, done.stderr
    return target / MACHINE / "debug" / "rustdds-node"


def version(cargo: str) -> tuple[int, ...]:
    """Return Cargo's version."""
    done = subprocess.run([cargo, "--version"], capture_output=True, text=True, check=False)
    found = re.search(r"(\d+)\.(\d+)", done.stdout)
    return tuple(map(int, found.groups())) if found else (0,)
