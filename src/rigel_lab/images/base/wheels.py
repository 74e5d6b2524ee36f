"""Wheels of a lock file, downloaded with pip; independent of their content."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.report import Reporter
from rigel_k8s.system.process import run, succeeds


def fetch(
    lock: str,
    directory: Path,
    report: Reporter,
    *,
    what: str,
    python: str,
    platforms: Sequence[str],
) -> list[Path]:
    """Download the wheels of a requirements file with digests, from the index that pip uses.

    Args:
        what: the wheels' purpose, for people.
        python: the version of the Python that they are for.
        platforms: those whose wheels run there, as pip names them.

    Raises:
        RigelK8sError: pip is not installed.
        CommandFailed: pip failed, or a wheel does not match its digest.
    """
    directory.mkdir(parents=True, exist_ok=True)
    requirements = directory / "requirements.txt"
    requirements.write_text(lock, "utf-8")
    key = f"{what} wheels"
    report.progress(key, "downloading")
    command = [*_find_pip(), "download", "--quiet", "--no-deps", "--require-hashes"]
    command += ["--only-binary=:all:", "--python-version", python]
    command += [word for platform in platforms for word in ("--platform", platform)]
    command += ["--requirement", str(requirements), "--dest", str(directory)]
    run(
        command,
        what=f"downloading the wheels of {what} with pip",
        hint="check that PyPI, or the index that pip is set up with, can be reached",
    )
    report.progress(key, "downloaded", done=True)
    return sorted(directory.glob("*.whl"))


def _find_pip() -> list[str]:
    """Return a pip: that of this Python, or the first on PATH."""
    own = [sys.executable, "-m", "pip"]
    if succeeds([*own, "--version"]):
        return own
    if other := shutil.which("pip3") or shutil.which("pip"):
        return [other]
    raise RigelK8sError(
        "pip, which downloads wheels, is not installed",
        hint=f"install it for {sys.executable}, or put one on PATH "
        "(Debian: sudo apt-get install python3-pip), and retry",
    )
