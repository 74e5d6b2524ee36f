"""Runs an image's own ros2 launch on a launch file in Python, to read what it would start.

The program inside of the container is evaluator.py. It gets no network.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from rigel_import.launch import evaluator
from rigel_k8s.errors import CommandFailed, UserError
from rigel_k8s.image_reference import parse_reference
from rigel_k8s.system.process import LAST_LINES, Finished, finish

#: Seconds for pulling the image and evaluating the file.
PATIENCE = 1800
#: Seconds in which a program must say that it works.
PROBE = 60
NEEDS = "the image needs python3 and ros2launch, and an ENTRYPOINT that sets up ROS 2"


def evaluate(request: Mapping[str, Any], image: str, folders: Iterable[Path]) -> dict[str, Any]:
    """Return what a launch file would start, as evaluator.py describes it.

    Args:
        request: as in `evaluator.evaluate`.
        image: the image in which the file is evaluated.
        folders: what the container sees of this computer, read-only and at the same paths.

    Raises:
        UserError: neither podman nor docker works here, or the launch file raised an error.
        CommandFailed: the container did not run it.
    """
    program = find_program()
    words = [program, "run", "--rm", "--network", "none", "--security-opt", "label=disable"]
    for folder in select_outermost(folders):
        words += ["--mount", f"type=bind,source={folder},target={folder},readonly"]
    name = str(parse_reference(image)) if Path(program).name == "podman" else image
    script = Path(evaluator.__file__).read_text("utf-8")
    done = finish(
        [*words, name, "python3", "-c", script, json.dumps(request)],
        what=f"{Path(program).name} run {image}",
        timeout=PATIENCE,
    )
    return read_output(done, image)


def find_program() -> str:
    """Return docker if it works, else podman, in the order in which images are built."""
    for name in ("docker", "podman"):
        program = shutil.which(name)
        with suppress(CommandFailed):
            if program and finish([program, "version"], timeout=PROBE).code == 0:
                return program
    raise UserError(
        "neither docker nor podman works here, to evaluate a launch file in Python in its image",
        hint="install podman (Debian: sudo apt-get install podman), or start the file in one pod,"
        " with `launch` of a node",
    )


def select_outermost(folders: Iterable[Path]) -> list[Path]:
    """Return folders without those inside of others."""
    found = {folder.resolve() for folder in folders}
    return sorted(one for one in found if not found & {*one.parents})


def read_output(done: Finished, image: str) -> dict[str, Any]:
    """Return the document that the container has printed."""
    _, begun, rest = done.output.partition(f"{evaluator.BEGIN}\n")
    text, ended, _ = rest.partition(f"\n{evaluator.END}")
    if not (begun and ended):
        message = f"{image} did not evaluate the launch file (exit code {done.code})"
        raise CommandFailed(message, hint=NEEDS, details=done.lines[-LAST_LINES:])
    document: dict[str, Any] = json.loads(text)
    if error := document.get("error"):
        where = "{}:{}: ".format(*make_place(error["place"])) if error["place"] else ""
        message, *details = error["message"].splitlines()
        hint = "pass arguments with --arg NAME=VALUE, or correct the file"
        if message.startswith(("ImportError", "ModuleNotFoundError", "PackageNotFoundError")):
            hint = f"{NEEDS}, and all packages that the file uses: build it from the workspace"
        raise UserError(f"{where}{message}", hint=hint, details=details)
    return document


def make_place(place: tuple[str, int]) -> tuple[str, int]:
    """Return a place in a file of this computer from the present directory."""
    file, line = place
    return (os.path.relpath(file) if Path(file).exists() else file), line
