"""What does not fit Kubernetes' own description of its objects has its place in the Rigelfile."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.app.checks.schema import Place, check_value

from .shapes import problems
from .test_golden import CASES, make

#: Below a container, what is said of it, and where; "" for nothing.
CONTAINER = [
    ("stdin: 'yes'", "must be true or false, not text", "stdin"),
    ("stdin: 'true'", "not text: remove the quotes", "stdin"),
    ("ports: [{containerPort: '80'}]", "whole number, not text: remove the quotes",)
    + ("ports.0.containerPort",),
    ("ports: [{hostPort: 80}]", "needs `containerPort`", "ports.0"),
    ("args: [1]", 'args[0] of a Deployment must be text: write "1" in quotes', "args.0"),
    ("env: [{name: A, value: 1}]", 'write "1" in quotes', "env.0.value"),
    ("env: [{value: a}]", "env[0] of a Deployment needs `name`", "env.0"),
    ("env: [{name: A, valueFrom: {secretKeyRef: {name: s}}}]",)
    + ("valueFrom.secretKeyRef of a Deployment needs `key`", "env.0.valueFrom.secretKeyRef"),
    ("volumeMounts: [{mountPath: /a, readOnly: true}]", "", ""),
    ("resources: {limits: {cpu: 1, memory: 1Gi}}", "", ""),
    ("resources: {limits: {cpu: true}}", "must be a quantity, not true or false",)
    + ("resources.limits.cpu",),
    ("livenessProbe: {tcpSocket: {port: http}}", "", ""),
    ("livenessProbe: {tcpSocket: {}}", "needs `port`", "livenessProbe.tcpSocket"),
    ("livenessProbe: {exec: {comand: [a]}}", 'did you mean "command"?',)
    + ("livenessProbe.exec.comand",),
    ("envFrom: [{secretRef: {name: s}}], workingDir: /a", "", ""),
    ("image: null, livenessProbe: null", "", ""),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words", "place"), CONTAINER)
def test_each_field_of_a_patch_is_compared(text: str, words: str, place: str) -> None:
    """What is laid over something need not be complete; what replaces it must be."""
    patch = f"{{spec: {{template: {{spec: {{containers: [{{name: ros-node, {text}}}]}}}}}}}}"
    found = [
        one
        for one in problems(f"{{image: a, nodes: {{n: {{args: x, patch: {patch}}}}}}}")
        if one.kind in ("wrong-type", "unknown-key", "incomplete")
    ]
    above = "nodes.n.patch.spec.template.spec.containers.0."
    assert [".".join(map(str, one.path)) for one in found] == ([above + place] if place else [])
    assert all(words in one.message for one in found)


def test_a_field_of_a_newer_kubernetes_is_a_warning() -> None:
    """The cluster may have it; if not, it refuses the deploy."""
    text = "{image: a, nodes: {n: {args: x, patch: {spec: {zzz: 1}}}}}"
    [found] = problems(text)
    assert found.severity == "warning"
    assert "Kubernetes v1.37 has no field" in found.message


def test_raw_parts_of_a_node_are_compared_too() -> None:
    node = "env: [{name: A, valueFrom: {secretKeyRef: {nam: s, key: k}}}]"
    [found] = problems(f"{{image: a, nodes: {{n: {{args: x, {node}}}}}}}")
    assert found.path == ("nodes", "n", "env", 0, "valueFrom", "secretKeyRef", "nam")
    assert found.message == 'unknown field "nam", did you mean "name"?'


def test_a_value_that_waits_for_a_run_is_left_alone() -> None:
    place = Place((), "a securityContext")
    assert list(check_value({"runAsUser": "{{ data.user }}"}, "SecurityContext", place)) == []


@pytest.mark.parametrize("case", CASES)
def test_what_rigel_makes_fits(case: str) -> None:
    def check(item: dict[str, Any]) -> list[str]:
        place = Place((), item["metadata"]["name"], whole=True)
        return [one.message for one in check_value(item, item["kind"], place)]

    made = [item for item in make(case) if item["kind"] in ("Deployment", "Job")]
    assert [check(item) for item in made] == [[] for _ in made]
