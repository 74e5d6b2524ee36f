"""logs: finds the release, and reads the lines of its nodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rigel_k8s.commands.logs.history import history
from rigel_k8s.commands.logs.lines import LogLine, LogOptions
from rigel_k8s.commands.targets import release
from rigel_k8s.settings import Settings


def logs(
    settings: Settings, nodes: Sequence[str], options: LogOptions, job: str | None = None
) -> Iterator[LogLine]:
    """Yield log lines of the nodes (all, if none is named); `follow` ends when it is closed.

    Raises:
        UserError: the node is unknown, or there is no pod at all.
        ClusterError: the one requested pod has no log.
    """
    found = release(settings, job, nodes)
    with found.cluster:
        yield from history(found, nodes, options)
