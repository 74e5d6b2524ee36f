"""How long a container without probes must run before its pod counts as available.

Without a probe a container is ready as soon as it runs, and the kubelet, which looks once a second,
reports a crash late. Kubernetes' own `minReadySeconds` waits for that. It is not part of the pods'
template.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.objects.overlay import simplify

#: Kubernetes stores in whole seconds when a pod became ready, so of N it may wait N - 1: with 1
#: every crash that was measured counted as ready, because the kubelet reported it later.
SECONDS = 2

KINDS = ("Deployment", "DaemonSet")


def steady(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return an object as plain data; workloads with unprobed containers get minReadySeconds."""
    made: dict[str, Any] = simplify(item)
    if made["kind"] in KINDS and find_unprobed(made["spec"]["template"]["spec"]):
        made["spec"] = {"minReadySeconds": SECONDS, **made["spec"]}
    return made


def find_unprobed(pod_spec: Mapping[str, Any]) -> list[str]:
    """Return the names of a pod's containers that are ready as soon as they run."""
    probes = ("readinessProbe", "startupProbe")
    found = pod_spec.get("containers") or []
    return [str(c["name"]) for c in found if not any(c.get(probe) for probe in probes)]
