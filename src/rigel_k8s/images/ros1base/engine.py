"""The archive into podman or docker, whichever is here."""

from __future__ import annotations

import shutil
import subprocess

from rigel_k8s.errors import CommandFailed, RigelK8sError
from rigel_k8s.images.ros1base.build import BaseImage
from rigel_k8s.sequences.job import Reporter

__all__ = ["load"]


def load(image: BaseImage, report: Reporter, *, engine: str | None = None) -> str:
    """Load the image into a container engine and return that engine's name.

    Args:
        image: what to load.
        report: where to tell what happens.
        engine: `podman` or `docker`; None takes the first that is installed, podman before docker.

    Raises:
        RigelK8sError: neither is installed.
        CommandFailed: the engine refused the archive.
    """
    program = engine or _installed()
    report.progress(image.reference, f"loading into {program}")
    command = [program, "load", "--input", str(image.archive)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CommandFailed(
            f"{program} could not load {image.archive} (exit code {done.returncode})",
            hint=f"try `{' '.join(command)}` by hand",
            details=tuple((done.stdout + done.stderr).splitlines()[-15:]),
        )
    report.progress(image.reference, f"loaded into {program}", done=True)
    return program


def _installed() -> str:
    for program in ("podman", "docker"):
        if shutil.which(program):
            return program
    raise RigelK8sError(
        "neither podman nor docker is installed, so the ROS 1 base image cannot be loaded",
        hint="install one (Debian: sudo apt-get install podman) and retry",
    )
