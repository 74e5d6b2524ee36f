"""Which parts of the stack may be in a namespace with the Pod Security level "restricted"."""

from __future__ import annotations

from rigel_k8s.objects.podsecurity import find_violations
from tests.support.podsecurity import list_missing

from .test_golden import CASES, FOLDER

WORKLOADS = ("Deployment", "DaemonSet", "StatefulSet")


def test_only_what_reads_the_machines_needs_more() -> None:
    """All other parts pass the level, as docs/security.md says."""
    passing, refused = set(), set()
    for case in CASES:
        for item in FOLDER.make(case):
            if item.get("kind") in WORKLOADS:
                spec = item["spec"]["template"]["spec"]
                bad = list(find_violations(spec)) or list_missing(spec)
                (refused if bad else passing).add(item["metadata"]["name"])
    assert refused == {"otel-collector", "promtail", "node-exporter"}
    assert passing == {"loki", "prometheus", "grafana", "kube-state-metrics"}
