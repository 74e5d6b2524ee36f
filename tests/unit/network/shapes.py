"""Networks as a Rigelfile has them, and what they become."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import attrs
import yaml

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.network.modes import network_objects, wire_pod
from rigel_k8s.network.plan import network_plan
from rigel_k8s.network.wiring import NETWORK_ANNOTATION, NetworkPlan, PodIdentity
from rigel_k8s.objects.overlay import simplify

from ..app.shapes import options

GOLDEN = Path(__file__).parent / "golden"


def plan(text: str) -> NetworkPlan:
    """Return the plan that a case describes: the job's `with`, the distro, the pods."""
    case = yaml.safe_load(text)
    chosen = options(yaml.safe_dump(case["with"]))
    return network_plan(
        chosen.network,
        namespace="robots",
        release="demo",
        ros=GENERATIONS[case.get("ros", "2")],
        distro=case.get("distro", "jazzy"),
        middleware=chosen.middleware,
        pods=[PodIdentity(**{"image": "ros:x", **pod}) for pod in case["pods"]],
        previous=[revision(*item) for item in (case.get("previous") or {}).items()],
    )


def revision(name: str, address: str) -> dict[str, Any]:
    """Return a workload of an earlier revision that has an address."""
    note = {NETWORK_ANNOTATION: json.dumps({"address": address})}
    return {"metadata": {"name": name}, "spec": {"template": {"metadata": {"annotations": note}}}}


def make_objects(told: NetworkPlan) -> Iterator[Mapping[str, Any]]:
    """Yield the objects of a plan, then the wiring of each pod."""
    for _, item in network_objects(told):
        yield simplify(item)
    for pod in told.pods:
        found = attrs.asdict(wire_pod(told, pod), recurse=False)
        yield {"wiring": pod.name} | {key: simplify(v) for key, v in found.items() if v}
