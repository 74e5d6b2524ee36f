"""Nodes and options on their way into a Rigelfile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

#: What marks the use of a var inside of a text; no file of a robot contains these characters.
VAR_START, VAR_END = "\ue000", "\ue001"


def use_var(name: str) -> str:
    """Return the use of a var as a part of a text: `{{ vars.NAME }}` in the Rigelfile."""
    return f"{VAR_START}{name}{VAR_END}"


@attrs.frozen(order=True)
class Place:
    """A place in a file; lines start at 1."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@attrs.frozen
class Remark:
    """Something that is not carried over, or works differently from how it looks.

    Attributes:
        message: what, and what takes its place, in one sentence without a full stop.
        node: the key of the node that it is about; None: all of it.
    """

    place: Place
    message: str
    node: str | None = None


@attrs.frozen
class Draft:
    """What becomes a Rigelfile.

    Attributes:
        name: the robot's, which its namespace gets.
        distro: the ROS distribution.
        nodes: the options of each node, by key, as docs/reference.md has them.
        options: the options of the job that deploys them, beside `nodes`.
        vars: the Rigelfile's.
        jobs: jobs that come before it, as those that build an image.
        remarks: in the order of the files.
        files: texts of files that stand beside the Rigelfile, by their paths.
    """

    name: str
    distro: str
    nodes: Mapping[str, Mapping[str, Any]]
    options: Mapping[str, Any] = attrs.field(factory=dict)
    vars: Mapping[str, Any] = attrs.field(factory=dict)
    jobs: Mapping[str, Mapping[str, Any]] = attrs.field(factory=dict)
    remarks: tuple[Remark, ...] = ()
    files: Mapping[str, str] = attrs.field(factory=dict)
