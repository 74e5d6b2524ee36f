"""Which parts of the stack may be in a namespace with the Pod Security level "restricted"."""

from __future__ import annotations

from pathlib import Path

import yaml

from rigel_k8s.objects.podsecurity import find_violations
from tests.support.podsecurity import list_missing

GOLDEN = Path(__file__).parent / "golden"
WORKLOADS = ("Deployment", "DaemonSet", "StatefulSet")


def test_only_what_reads_the_machines_needs_more() -> None:
    """All other parts pass the level, as docs/security.md says."""
    passing, refused = set(), set()
    for file in GOLDEN.glob("*.yaml"):
        for item in filter(None, yaml.safe_load_all(file.read_text("utf-8"))):
            if item.get("kind") in WORKLOADS:
                spec = item["spec"]["template"]["spec"]
                bad = list(find_violations(spec)) or list_missing(spec)
                (refused if bad else passing).add(item["metadata"]["name"])
    assert refused == {"otel-collector", "promtail", "node-exporter"}
    assert passing == {"loki", "prometheus", "grafana", "kube-state-metrics", "alloy"}
