"""Which pods ask for a second network."""

from __future__ import annotations

from rigel_multus.preflight.case import find_wanted

from .cases import workload


def test_who_is_wired() -> None:
    """Workloads with an attachment or on the machine's network; no replicas said is one."""
    none = workload("plain", networks=None)
    off = workload("off", replicas=0)
    found = list(
        find_wanted([none, off, workload("one"), workload("host", None, hostNetwork=True)])
    )
    assert [(w.workload, w.pods) for w in found] == [("off", 0), ("one", 1), ("host", 1)]
