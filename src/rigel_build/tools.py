"""Finds the program that builds images: docker or podman, installed and working."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

from rigel_build.docker import Docker
from rigel_build.engine import Engine
from rigel_build.podman import ISOLATION, Podman, misses_sys_resource
from rigel_k8s.errors import CommandFailed, RigelK8sError
from rigel_k8s.system.process import finish

_PROBE_SECONDS = 60
_INSTALL = "install podman (Debian: sudo apt-get install podman), or Docker with its buildx plugin"


def find_engine(
    tool: str, environ: Mapping[str, str], status: Path = Path("/proc/self/status")
) -> Engine:
    """Return docker or podman; `auto` takes docker if it works, else podman.

    Raises:
        RigelK8sError: the requested one is not installed or cannot build, with the reason.
    """
    wanted = ("docker", "podman") if tool == "auto" else (tool,)
    reasons = []
    for name in wanted:
        found = _docker(environ) if name == "docker" else _podman(environ, status)
        if not isinstance(found, str):
            return found
        reasons.append(found)
    raise RigelK8sError(f"cannot build images here: {'; '.join(reasons)}", hint=_INSTALL)


def _docker(environ: Mapping[str, str]) -> Docker | str:
    """Return docker, or why it cannot build."""
    program = shutil.which("docker", path=environ.get("PATH"))
    if program is None:
        return "docker is not installed"
    works, _ = _ask([program, "buildx", "version"], environ)
    if not works:
        return "docker is installed without its buildx plugin"
    works, output = _ask([program, "buildx", "inspect", "--bootstrap"], environ)
    if not works or "Status:" not in output or "Error:" in output:
        return f"cannot reach docker's builder ({_find_last(output)})"
    return Docker(program, output)


def _podman(environ: Mapping[str, str], status: Path) -> Podman | str:
    """Return podman, or why it cannot build."""
    program = shutil.which("podman", path=environ.get("PATH"))
    if program is None:
        return "podman is not installed"
    works, output = _ask([program, "version"], environ)
    if not works:
        return f"podman does not run ({_find_last(output)})"
    chosen = ISOLATION in environ or not status.exists()
    chroot = not chosen and misses_sys_resource(status.read_text("utf-8"))
    return Podman(program, isolation="chroot" if chroot else None)


def _ask(words: list[str], environ: Mapping[str, str]) -> tuple[bool, str]:
    """Return whether a program succeeds, and its output, or why it did not start."""
    try:
        done = finish(words, env=environ, timeout=_PROBE_SECONDS)
    except CommandFailed as error:
        return False, error.message
    return done.code == 0, "\n".join(done.lines)


def _find_last(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return lines[-1] if lines else "no reason given"
