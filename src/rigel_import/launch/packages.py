"""The ROS packages of the workspace around a launch file."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from itertools import islice
from pathlib import Path

from rigel_k8s.errors import UserError
from rigel_k8s.rigelfile.findings import suggest

NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
#: Directories that are not searched.
BUILT = ("build", "install", "devel", "log")
#: Directories of a workspace that are searched.
MOST = 20_000


def find_package(file: Path) -> tuple[str, Path] | None:
    """Return the name and directory of the package that a file is in; None outside packages."""
    for directory in file.resolve().parents:
        if (name := read_name(directory)) is not None:
            return name, directory
    return None


def read_name(directory: Path) -> str | None:
    """Return the name of the package whose directory it is, None for another directory."""
    try:
        match = NAME.search((directory / "package.xml").read_text("utf-8", "replace"))
    except OSError:
        return None
    return match[1] if match else None


def find_workspace(file: Path) -> Path:
    """Return the nearest directory above a file's package that is `src` or a repository.

    If there is none: the one directly above the package.
    """
    package = find_package(file)
    start = package[1].parent if package else file.resolve().parent
    for path in (start, *start.parents):
        if path.name == "src" or (path / ".git").exists():
            return path
    return start


def find_packages(root: Path) -> dict[str, Path]:
    """Return the directories of packages below a directory, by name."""
    found: dict[str, Path] = {}
    for place, directories, _ in islice(os.walk(root), MOST):
        if name := read_name(Path(place)):
            found.setdefault(name, Path(place))
            directories.clear()
        directories[:] = sorted(d for d in directories if d not in BUILT and d[0] != ".")
    return found


def find_launch_file(package: str, name: str, known: Mapping[str, Path]) -> Path:
    """Return a launch file of a package, as roslaunch and ros2 launch find it.

    Args:
        known: directories of packages that are not below the present one, or win over those there.

    Raises:
        UserError: there is no such package, or it has no such file, or several.
    """
    packages = {**find_packages(Path.cwd()), **known}
    if package not in packages:
        message = f'no package "{package}" below this directory{suggest(package, packages)}'
        raise UserError(message, hint=f"pass --package {package}=DIRECTORY, or the file's path")
    files = sorted(packages[package].rglob(name))
    if len(files) != 1:
        count = f"{len(files)} files" if files else "no file"
        listed = ", ".join(os.path.relpath(file) for file in files)
        hint = f"pass the path of one of them: {listed}" if files else "check its name"
        raise UserError(f'{package} has {count} "{name}"', hint=hint)
    return Path(os.path.relpath(files[0]))
