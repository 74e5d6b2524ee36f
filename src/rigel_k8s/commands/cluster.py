"""cluster up: a local cluster with images that other packages build."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import attrs

from rigel_k8s import lab
from rigel_k8s.lab import exporter


@attrs.frozen
class Steps:
    """A Reporter of steps only."""

    show: Callable[[str], None]

    def line(self, text: str) -> None:
        """Report a step."""
        self.show(text)

    def warn(self, text: str) -> None:
        """Report a warning."""
        self.show(text)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Ignore what happens within a step."""


def up(
    name: str,
    nodes: int | None,
    *,
    extras: Sequence[str],
    data_dir: str | None,
    report: Callable[[str], None],
) -> lab.cluster.ClusterStatus:
    """Start a cluster, or the parts of it that do not run; see `lab.cluster.up`.

    With "observability" it also serves the ROS exporter, which is built here.
    """
    return lab.cluster.up(
        name,
        nodes,
        extras=extras,
        data_dir=data_dir,
        made={"observability": {exporter.UPSTREAM: partial(ros_exporter, report)}},
        report=report,
    )


def ros_exporter(report: Callable[[str], None]) -> Path:
    """Return the archive of the ROS exporter's image; build it if it does not exist."""
    return exporter.build(Steps(report)).archive
