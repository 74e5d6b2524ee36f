"""Which workloads must run for some seconds before they count, and that no pod's template tells."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.steady import SECONDS, steady

from ..app.shapes import find, release

PROBE = {"readinessProbe": {"tcpSocket": {"port": 1}}}


def workload(*containers: dict[str, Any], kind: str = "Deployment", **spec: Any) -> dict[str, Any]:
    return {"kind": kind, "spec": {**spec, "template": {"spec": {"containers": [*containers]}}}}


@pytest.mark.parametrize(
    ("made", "seconds"),
    [
        (workload({"name": "a"}), SECONDS),
        (workload({"name": "a"}, kind="DaemonSet"), SECONDS),
        (workload({"name": "a", **PROBE}, {"name": "b"}), SECONDS),
        (workload({"name": "a", **PROBE}), None),
        (workload({"name": "a", "startupProbe": {}, **PROBE}), None),
        (workload({"name": "a"}, minReadySeconds=0), 0),
        (workload({"name": "a"}, minReadySeconds=9), 9),
        ({"kind": "Service", "spec": {}}, None),
    ],
)
def test_a_container_that_nobody_probes_needs_its_seconds(
    made: dict[str, Any], seconds: int | None
) -> None:
    """Any such container counts; a number of the user's own stays."""
    assert steady(made)["spec"].get("minReadySeconds") == seconds


def test_the_template_is_as_it_was() -> None:
    """A changed template would restart robots."""
    made = workload({"name": "a", "env": [{"name": "A", "value": None}]})
    template = steady(made)["spec"]["template"]
    assert template == made["spec"]["template"]
    assert "minReadySeconds" not in made["spec"]


@pytest.mark.parametrize(
    ("node", "seconds"),
    [
        ("{readiness: none}", SECONDS),
        ("{}", None),
        ("{readiness: {command: /ready}}", None),
        ("{readiness: none, patch: {spec: {minReadySeconds: 0}}}", 0),
    ],
)
def test_a_node_without_readiness_needs_its_seconds(node: str, seconds: int | None) -> None:
    """What the Rigelfile says decides; roscore has probes of its own."""
    made = release(f"{{image: i, nodes: {{talker: {node}}}}}")
    assert find(made, "Deployment", "talker")["spec"].get("minReadySeconds") == seconds
    assert "minReadySeconds" not in find(made, "Deployment", "ros-master")["spec"]
