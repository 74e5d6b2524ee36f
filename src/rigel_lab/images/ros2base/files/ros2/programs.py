"""Starting the executables of packages."""

import os
from pathlib import Path


class Failure(Exception):
    """A failure that the user can correct: the message; the exit code is 1."""


def run(words):
    """Become the executable: signals reach the node itself, also as process 1."""
    if len(words) < 2 or words[0].startswith("-"):
        raise Failure("usage: ros2 run PACKAGE EXECUTABLE [ARGS]")
    program = executable(*words[:2])
    os.execv(program, [program, *words[2:]])


def executable(package, name):
    """Return the path of a package's executable."""
    directory = prefix(package) / "lib" / package
    found = sorted(p for p in directory.rglob(name) if p.is_file() and os.access(p, os.X_OK))
    if not found:
        known = sorted(p.name for p in directory.rglob("*") if os.access(p, os.X_OK))
        there = f"it has: {', '.join(known)}" if known else "it has none"
        raise Failure(f"No executable found: '{name}' of package '{package}' ({there})")
    if len(found) > 1:
        raise Failure("Multiple executables found:\n" + "\n".join(map(str, found)))
    return str(found[0])


def prefix(package):
    """Return the installation that has a package."""
    for one in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(":")):
        if (Path(one) / "share/ament_index/resource_index/packages" / package).exists():
            return Path(one)
    raise Failure(f"Package '{package}' not found")
