"""All checks of preflight, in the order in which their findings are reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from rigel_k8s.network.preflight.case import Case
from rigel_k8s.network.preflight.finding import PreflightFinding
from rigel_k8s.network.preflight.interfaces import interfaces
from rigel_k8s.network.preflight.limits import buffers, neighbours, policies
from rigel_k8s.network.preflight.presence import clouds, presence, programs
from rigel_k8s.network.preflight.ranges import ranges, room

CHECKS: Sequence[Callable[[Case], Iterator[PreflightFinding]]] = (
    presence,
    programs,
    interfaces,
    ranges,
    room,
    buffers,
    neighbours,
    policies,
    clouds,
)


def findings(case: Case) -> list[PreflightFinding]:
    """Return everything that keeps a release's network from working, each once."""
    return list(dict.fromkeys(finding for check in CHECKS for finding in check(case)))
