"""What any container engine does for a build."""

from __future__ import annotations

import hashlib
import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import attrs

from rigel_k8s.image_reference import is_reference, parse_reference
from rigel_k8s.images.credentials import RegistryCredentials

_FROM = re.compile(r"(?im)^\s*FROM\s+(?:--\S+\s+)*(\S+)")


@attrs.frozen
class Build:
    """One image to build.

    Attributes:
        names: all names that the image gets, each with its tag.
        context: the directory that COPY reads.
        dockerfile: the Dockerfile's path.
        buildargs: values of ARG, by name.
        platforms: `linux/arm64` and the like; none: this machine's.
    """

    names: tuple[str, ...]
    context: Path
    dockerfile: Path
    buildargs: Mapping[str, str] = attrs.field(factory=dict)
    platforms: tuple[str, ...] = ()

    def registries(self) -> set[str]:
        """Return the registries that it names: its own, those of FROM and of build arguments."""
        texts = [
            *self.names,
            *self.buildargs.values(),
            *_FROM.findall(self.dockerfile.read_text("utf-8")),
        ]
        return {parse_reference(text).registry for text in texts if is_reference(text)}


@attrs.frozen
class Session:
    """What an engine works with during one job.

    Attributes:
        directory: for its own files; removed after the job.
        environ: the environment that its programs start from.
        cancel: ends its programs when set.
        on_state: is called with the state of a long step.
        credentials: for the registries that it pulls from and pushes to.
        insecure: registries to use over plain HTTP, or without verifying certificates.
    """

    directory: Path
    environ: Mapping[str, str]
    cancel: threading.Event = attrs.field(factory=threading.Event)
    on_state: Callable[[str], None] = lambda _: None
    credentials: tuple[RegistryCredentials, ...] = ()
    insecure: frozenset[str] = frozenset()


class Engine(Protocol):
    """docker or podman, found and able to build."""

    @property
    def name(self) -> str:
        """`docker` or `podman`."""

    @property
    def more_platforms(self) -> str:
        """How to make it build for other platforms."""

    def platforms(self) -> Sequence[str]:
        """Return the platforms it can build for, this machine's first."""

    def build(self, build: Build, session: Session, *, load: bool, push: bool) -> dict[str, str]:
        """Build, and push if requested; returns the digest of each pushed name."""

    def save(self, names: Sequence[str], file: Path, session: Session) -> None:
        """Write images that were built with `load` to an archive that containerd imports."""


LABEL = "rigel-k8s.build-arg"


def mark(dockerfile: str, buildargs: Mapping[str, str]) -> str:
    """Return a Dockerfile with a label behind each ARG of a stage whose value is given."""
    marked = list(lines(dockerfile.splitlines(), buildargs))
    return dockerfile if marked == dockerfile.splitlines() else "\n".join([*marked, ""])


def lines(text: Sequence[str], buildargs: Mapping[str, str]) -> Iterator[str]:
    in_stage, goes_on = False, False
    for line in text:
        yield line
        begins, goes_on = not goes_on, line.endswith("\\")
        in_stage |= begins and bool(re.match(r"(?i)\s*FROM\s", line))
        if in_stage and begins and not goes_on:
            for name in parse_names(line):
                if name in buildargs:
                    digest = hashlib.sha256(buildargs[name].encode()).hexdigest()[:12]
                    yield f'LABEL {LABEL}.{name}="{digest}"'


def parse_names(line: str) -> list[str]:
    """Return the names that an ARG instruction declares."""
    found = re.match(r"(?i)\s*ARG\s+(.+)", line)
    return re.findall(r"(?:^|\s)(\w+)(?==|\s|$)", found.group(1)) if found else []


def pass_on(
    buildargs: Mapping[str, str], env: Mapping[str, str]
) -> tuple[list[str], dict[str, str]]:
    """Return the words of a build for its arguments, and the environment that has their values.

    Every user of a machine can read the arguments of its processes, and a build argument may be a
    token. A name that the environment has with another value keeps its value in the words: the
    program itself may need the other one (for example PATH).
    """
    hidden = {name: value for name, value in buildargs.items() if env.get(name, value) == value}
    words = []
    for name, value in buildargs.items():
        words += ["--build-arg", name if name in hidden else f"{name}={value}"]
    return words, {**env, **hidden}
