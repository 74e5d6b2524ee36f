"""Build arguments that podman's cache would overlook; pure.

podman compares the values of build arguments for RUN alone: `ENV V=${V}` of an earlier build is
taken from the cache whatever V is now (seen with 4.3; buildah's issue 5501 is open). A label with a
digest of the value behind each ARG makes the instruction's text, which is compared, change with it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence

LABEL = "rigel-k8s.build-arg"


def mark(dockerfile: str, buildargs: Mapping[str, str]) -> str:
    """Return a Dockerfile with a label behind each ARG of a stage whose value is given."""
    marked = list(lines(dockerfile.splitlines(), buildargs))
    return dockerfile if marked == dockerfile.splitlines() else "\n".join([*marked, ""])


def lines(text: Sequence[str], buildargs: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines and the labels."""
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
