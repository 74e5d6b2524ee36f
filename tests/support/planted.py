"""Secrets that a test has planted: looked for in texts, processes and files, while commands run."""

from __future__ import annotations

import base64
import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import attrs

#: Characters of a secret that are enough to know it by: keys and tokens are broken into lines.
ENOUGH = 40


def forms(secret: str) -> set[str]:
    """Return a secret as it is, and as base64 by itself and behind the user's name."""
    texts = (secret, f"me:{secret}")
    return {secret, *(base64.b64encode(text.encode()).decode().rstrip("=") for text in texts)}


def find(secrets: Iterable[str], text: str) -> list[str]:
    """Return the forms of secrets that a text has in it."""
    return [form for secret in secrets for form in forms(secret) if form in text]


@attrs.define
class Trace:
    """What processes and directories had in them at any moment.

    Attributes:
        arguments: of all processes of the machine.
        environments: of all processes but this one and those that it has forked.
        exposed: files with a secret that others than their owner could read.
        looks: how often all of it was looked at.
    """

    arguments: set[str] = attrs.field(factory=set)
    environments: set[str] = attrs.field(factory=set)
    exposed: set[str] = attrs.field(factory=set)
    looks: int = 0


@contextmanager
def tracing(directory: Path, secrets: Iterable[str]) -> Iterator[Trace]:
    """Look at processes, and at the files of a directory, for as long as the context is open."""
    trace, over = Trace(), threading.Event()
    own = read(Path("/proc/self/environ"))
    wanted = list(secrets)

    def look() -> None:
        while not over.wait(0.03):
            for process in Path("/proc").glob("[0-9]*"):
                trace.arguments.add(read(process / "cmdline"))
                if (environment := read(process / "environ")) != own:
                    trace.environments.add(environment)
            trace.exposed.update(find_exposed(directory, wanted))
            trace.looks += 1

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield trace
    finally:
        over.set()
        thread.join()


def find_exposed(directory: Path, secrets: Iterable[str]) -> Iterator[str]:
    """Yield the files with a secret in them that another user could read now."""
    for place, _, names in os.walk(directory):
        for file in (Path(place, name) for name in names):
            if find(secrets, read(file)) and is_open(file, directory):
                yield str(file)


def is_open(file: Path, directory: Path) -> bool:
    """Whether a file, and each directory on the way to it, is open to others than their owner."""
    try:
        ways = [file, *(above for above in file.parents if directory in above.parents)]
        return all(way.stat().st_mode & 0o055 for way in ways)
    except OSError:  # it is gone
        return False


def read(file: Path) -> str:
    """Return what a file holds; nothing where it is gone."""
    try:
        return file.read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
    except OSError:
        return ""


def find_left(directory: Path, secrets: Iterable[str]) -> list[str]:
    """Return the files of a directory that have a secret in them."""
    wanted = list(secrets)
    files = (Path(place, name) for place, _, names in os.walk(directory) for name in names)
    return [str(file) for file in files if find(wanted, read(file))]
