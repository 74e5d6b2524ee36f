"""Where a pod may run."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.scheduling import may_run


def node(name: str, **labels: str) -> dict[str, Any]:
    return {"metadata": {"name": name, "labels": labels}, "spec": {}}


def affinity(*rules: tuple[str, str, list[str]], fields: bool = False) -> dict[str, Any]:
    """A pod's required node affinity."""
    expressions = [{"key": key, "operator": word, "values": values} for key, word, values in rules]
    term = {"matchFields" if fields else "matchExpressions": expressions}
    required = {"requiredDuringSchedulingIgnoredDuringExecution": {"nodeSelectorTerms": [term]}}
    return {"affinity": {"nodeAffinity": required}}


@pytest.mark.parametrize(
    ("pod", "expected"),
    [
        ({}, True),
        ({"nodeName": "node1"}, True),
        ({"nodeName": "node2"}, False),
        ({"nodeSelector": {"arm": "left"}}, True),
        ({"nodeSelector": {"arm": "left", "gpu": "yes"}}, False),
        (affinity(("arm", "In", ["left", "right"])), True),
        (affinity(("arm", "NotIn", ["left"])), False),
        (affinity(("arm", "Exists", []), ("gpu", "DoesNotExist", [])), True),
        (affinity(("gpu", "Exists", [])), False),
        (affinity(("cores", "Gt", ["4"])), True),
        (affinity(("cores", "Lt", ["4"])), False),
        (affinity(("gpu", "Gt", ["4"])), False),
        (affinity(("metadata.name", "In", ["node1"]), fields=True), True),
        (affinity(("metadata.name", "In", ["node2"]), fields=True), False),
    ],
)
def test_where_a_pod_may_run(pod: dict[str, Any], *, expected: bool) -> None:
    """What a pod's spec says about nodes, as the scheduler reads it."""
    assert may_run(pod, node("node1", arm="left", cores="8")) is expected


def test_a_windows_machine_runs_no_ros_image() -> None:
    """ROS images are Linux', wherever the cluster has other machines."""
    assert not may_run({}, node("node1", **{"kubernetes.io/os": "windows"}))


TAINT = {"key": "robot", "value": "arm", "effect": "NoSchedule"}


@pytest.mark.parametrize(
    ("taint", "toleration", "expected"),
    [
        (TAINT, None, False),
        (TAINT, {"operator": "Exists"}, True),
        (TAINT, {"key": "robot", "operator": "Exists", "effect": "NoExecute"}, False),
        (TAINT, {"key": "robot", "operator": "Equal", "value": "arm"}, True),
        (TAINT, {"key": "robot", "value": "leg"}, False),
        ({**TAINT, "effect": "PreferNoSchedule"}, None, True),
        ({"key": "node.kubernetes.io/not-ready", "effect": "NoSchedule"}, None, True),
        ({"key": "node.kubernetes.io/unschedulable", "effect": "NoSchedule"}, None, False),
    ],
)
def test_taints(taint: dict[str, Any], toleration: Any, *, expected: bool) -> None:
    """Taints keep pods away unless tolerated; those of a machine that is off come and go."""
    machine = node("node1")
    machine["spec"]["taints"] = [taint]
    tolerations = [toleration] if toleration else []
    assert may_run({"tolerations": tolerations}, machine) is expected
