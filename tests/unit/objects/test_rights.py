"""Rights as data: what a rule grants, what is missing, and rules made of rights."""

from __future__ import annotations

import pytest

from rigel_k8s.objects.rights import Right, describe, find_missing, grant, make_rules

CREATE = Right("apps", "deployments", "create", "n")
LOGS = Right("", "pods/log", "get", "n")


@pytest.mark.parametrize(
    ("right", "groups", "resources", "verbs", "granted"),
    [
        (CREATE, ["apps"], ["deployments"], ["create"], True),
        (CREATE, ["*"], ["*"], ["*"], True),
        (CREATE, [""], ["deployments"], ["create"], False),
        (CREATE, ["apps"], ["deployments/scale"], ["create"], False),
        (CREATE, ["apps"], ["deployments"], ["get"], False),
        (LOGS, [""], ["pods"], ["get"], False),
        (LOGS, [""], ["pods/log"], ["get"], True),
        (LOGS, [""], ["*/log"], ["get"], True),
    ],
)
def test_a_rule_grants_as_kubernetes_reads_it(
    right: Right, groups: list[str], resources: list[str], verbs: list[str], *, granted: bool
) -> None:
    """A subresource is not part of its resource."""
    rule = {"apiGroups": groups, "resources": resources, "verbs": verbs}
    assert right.is_granted_by(rule) is granted


def test_rules_grant_what_they_are_made_of_and_nothing_else() -> None:
    """Resources with the same verbs share a rule; verbs stand in the usual order."""
    rights = [*grant("", "secrets configmaps", "patch get"), *grant("apps", "deployments", "get")]
    rules = make_rules(rights)
    assert rules == [
        {"apiGroups": [""], "resources": ["configmaps", "secrets"], "verbs": ["get", "patch"]},
        {"apiGroups": ["apps"], "resources": ["deployments"], "verbs": ["get"]},
    ]
    assert not find_missing(rights, rules)
    assert find_missing([CREATE], rules) == [CREATE]


def test_rights_are_listed_by_resource() -> None:
    """And one for the whole cluster is not taken for one in a namespace."""
    rights = [CREATE, Right("apps", "deployments", "list", "n"), Right("", "namespaces", "create")]
    assert describe(rights) == [
        "namespaces (in the whole cluster): create",
        "deployments.apps: create, list",
    ]
