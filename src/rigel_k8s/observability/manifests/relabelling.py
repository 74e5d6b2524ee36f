"""Labels of the contract (names.LABELS) from a pod's metadata, and files/relabelling.yaml.

Promtail, Prometheus and prometheus-operator all take them in this form.
"""

from __future__ import annotations

from typing import Any

from rigel_k8s.observability.manifests.frame import load
from rigel_k8s.observability.names import LABELS

Rule = dict[str, Any]


def contract() -> list[Rule]:
    """Return the rules that make a pod's labels."""
    return [{"source_labels": [source], "target_label": name} for name, source in LABELS.items()]


def rules(name: str) -> list[Rule]:
    """Return a list of files/relabelling.yaml, of the caller's own."""
    found: list[Rule] = load("relabelling.yaml")[name]
    return found
