"""What of quotas is used by a deploy: in the end, and at each moment of its roll-outs."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.refusals.quotas import (
    Change,
    amounts_of_object,
    amounts_of_pod,
    amounts_of_workload,
    find_excess,
    makes_new_pod_first,
)

TALKER = ObjectRef("apps/v1", "Deployment", "n", "talker")
LISTENER = ObjectRef("apps/v1", "Deployment", "n", "listener")


def quota(hard: str, used: str, resource: str = "pods", **spec: Any) -> dict[str, Any]:
    status = {"hard": {resource: hard}, "used": {resource: used}}
    return {"metadata": {"name": "small"}, "spec": spec, "status": status}


def pods(number: int) -> dict[str, Decimal]:
    return {"pods": Decimal(number)}


def pod(*containers: Any, init: Any = ()) -> dict[str, Any]:
    return {"spec": {"containers": list(containers), "initContainers": list(init)}}


def using(**requests: str) -> dict[str, Any]:
    return {"resources": {"requests": requests}}


@pytest.mark.parametrize(
    ("hard", "used", "changes", "fits"),
    [
        ("2", "0", [Change(TALKER, pods(1)), Change(LISTENER, pods(1))], True),
        ("1", "0", [Change(TALKER, pods(1)), Change(LISTENER, pods(1))], False),
        ("1", "1", [Change(TALKER, pods(1), freed=pods(1))], True),
        ("1", "1", [Change(TALKER, pods(1), pods(1), overlap=pods(1))], False),
        ("2", "1", [Change(TALKER, pods(1), pods(1), overlap=pods(1))], True),
        # Two roll-outs with an overlap find room for one pod more: one waits for the other.
        ("3", "2", [Change(r, pods(1), pods(1), pods(1)) for r in (TALKER, LISTENER)], True),
        ("2", "2", [Change(r, pods(1), pods(1), pods(1)) for r in (TALKER, LISTENER)], False),
        # The one that needs less room goes first, and gives back what the other one needs.
        (
            "6",
            "4",
            [
                Change(TALKER, pods(1), pods(1), pods(1)),
                Change(LISTENER, pods(3), pods(3), pods(3)),
            ],
            True,
        ),
        # A new workload may wait for the end of the other's roll-out.
        ("2", "1", [Change(TALKER, pods(1), pods(1), pods(1)), Change(LISTENER, pods(1))], True),
        # In the end it needs its room all the same.
        ("3", "1", [Change(TALKER, pods(1), pods(1), pods(1)), Change(LISTENER, pods(3))], False),
        ("1", "1", [Change(TALKER, pods(1), pods(2))], True),
        ("0", "1", [], True),
    ],
)
def test_only_what_cannot_be_is_refused(
    hard: str, used: str, changes: list[Change], *, fits: bool
) -> None:
    """In whatever order Kubernetes rolls the workloads out."""
    assert (not [*find_excess([quota(hard, used)], changes)]) is fits


def test_an_excess_has_its_numbers_and_who_causes_it() -> None:
    """Not the workloads that stay as they are."""
    changes = [Change(TALKER, pods(3)), Change(LISTENER, pods(1), freed=pods(1))]
    [found] = find_excess([quota("4", "2")], changes)
    assert (found.quota, found.resource, found.used, found.hard) == ("small", "pods", "2", "4")
    assert (found.added, found.refs) == ("3", (TALKER,))


@pytest.mark.parametrize(
    ("spec", "counts"),
    [
        ({"scopes": ["NotTerminating"]}, True),
        ({"scopes": ["BestEffort"]}, False),
        ({"scopeSelector": {"matchExpressions": []}}, False),
    ],
)
def test_quotas_of_some_pods_only_are_left_to_kubernetes(spec: Any, *, counts: bool) -> None:
    """Whether they count a pod is not known here: unknown is no refusal."""
    found = [*find_excess([quota("0", "0", **spec)], [Change(TALKER, pods(1))])]
    assert bool(found) is counts


def test_a_pod_takes_what_its_containers_take_together() -> None:
    """Init containers count where they need more; those that stay beside the others are added."""
    made = pod(using(cpu="1"), using(cpu="500m", memory="1Gi"), init=[using(cpu="1")])
    assert amounts_of_pod(made)["requests.cpu"] == Decimal("1.5")
    assert amounts_of_pod(made)["memory"] == 2**30
    first = pod(using(cpu="1"), init=[using(cpu="3")])
    assert amounts_of_pod(first)["cpu"] == 3
    beside = pod(using(cpu="1"), init=[{**using(cpu="3"), "restartPolicy": "Always"}])
    assert amounts_of_pod(beside)["cpu"] == 4
    sidecar = {**using(cpu="1"), "restartPolicy": "Always"}
    later = pod(using(cpu="1"), init=[sidecar, using(cpu="3")])
    assert amounts_of_pod(later)["cpu"] == 4


def test_what_a_runtime_class_adds_counts() -> None:
    made = pod(using(cpu="1"))
    made["spec"]["overhead"] = {"cpu": "250m"}
    assert amounts_of_pod(made)["cpu"] == Decimal("1.25")


def test_a_limit_is_the_request_that_is_not_said() -> None:
    """As Kubernetes fills it in."""
    limited = pod({"resources": {"limits": {"cpu": "2"}}})
    assert amounts_of_pod(limited)["requests.cpu"] == amounts_of_pod(limited)["limits.cpu"] == 2


def test_all_replicas_count() -> None:
    """Whatever the quota counts of each."""
    workload = {"spec": {"replicas": 3, "template": pod(using(cpu="1"))}}
    amounts = amounts_of_workload(workload)
    assert (amounts["pods"], amounts["cpu"]) == (3, 3)


def test_objects_count_by_both_their_names() -> None:
    """`count/secrets` and `secrets`; claims by their size too."""
    secret = {"apiVersion": "v1", "kind": "Secret"}
    assert amounts_of_object(secret, "secrets") == {"count/secrets": 1, "secrets": 1}
    spec = {"resources": {"requests": {"storage": "1Gi"}}}
    claim = {"apiVersion": "v1", "kind": "PersistentVolumeClaim", "spec": spec}
    assert amounts_of_object(claim, "persistentvolumeclaims")["requests.storage"] == 2**30
    lease = {"apiVersion": "coordination.k8s.io/v1", "kind": "Lease"}
    assert set(amounts_of_object(lease, "leases")) == {"count/leases.coordination.k8s.io"}
    other = {"apiVersion": "serving.knative.dev/v1", "kind": "Service"}
    assert set(amounts_of_object(other, "services")) == {"count/services.serving.knative.dev"}


@pytest.mark.parametrize(
    ("strategy", "replicas", "first"),
    [
        ({"type": "Recreate"}, 1, False),
        ({}, 1, True),
        ({}, 4, False),
        ({"rollingUpdate": {"maxUnavailable": 0}}, 4, True),
        ({"rollingUpdate": {"maxUnavailable": 1}}, 4, False),
    ],
)
def test_some_roll_outs_need_room_for_one_pod_more(
    strategy: Any, replicas: int, *, first: bool
) -> None:
    """Those that may not end a pod before the new one is ready; 25 % of one pod is none."""
    assert makes_new_pod_first({"spec": {"strategy": strategy, "replicas": replicas}}) is first
