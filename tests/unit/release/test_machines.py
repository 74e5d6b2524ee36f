"""Which workloads no machine of the cluster can run."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.release.refusals.needs import find_homeless
from rigel_k8s.release.refusals.verdict import Refused
from tests.support.manifests import desired, workload
from tests.support.releases import deploy, diff

HOST = "kubernetes.io/hostname"


def node(name: str, *taints: str, room: dict[str, str] | None = None, **labels: str) -> Any:
    marks = [{"key": key, "value": "yes", "effect": "NoSchedule"} for key in taints]
    return {
        "apiVersion": "v1",
        "kind": "Node",
        "metadata": {"name": name, "labels": {HOST: name, **labels}},
        "spec": {"taints": marks},
        "status": {"allocatable": room or {}},
    }


def placed(requests: dict[str, str] | None = None, **selector: str) -> dict[str, Any]:
    made = workload()
    pod = made["spec"]["template"]["spec"]
    pod["nodeSelector"] = {HOST if key == "host" else key: v for key, v in selector.items()}
    pod["containers"][0]["resources"] = {"requests": requests or {}}
    return made


NODES = (node("n1", robot="arm"), node("n2"))
SMALL = node("small", room={"cpu": "2", "memory": "4Gi"})
LARGE = node("large", room={"cpu": "4", "memory": "1Gi"})


@pytest.mark.parametrize(
    ("workload", "nodes", "text"),
    [
        (placed(host="n1", robot="arm"), NODES, None),
        (
            placed(robot="leg"),
            NODES,
            "no machine of the cluster has the labels robot=leg; kubectl label node NODE robot=leg",
        ),
        (
            placed(robot="arm", host="n2"),
            NODES,
            "no machine of the cluster has the labels robot=arm, kubernetes.io/hostname=n2;"
            " kubectl label node n2 robot=arm",
        ),
        (
            placed(host="n3"),
            NODES,
            "the cluster has no machine n3; its machines are n1, n2",
        ),
        (placed(host="n3"), (), None),  # machines that we may not see
        (
            placed(robot="arm"),
            (node("n1", "camera", robot="arm"), node("n2")),
            "the only machine that it may run on has a taint: n1 (camera=yes:NoSchedule);"
            " `kubectl taint node n1 camera-` removes one",
        ),
        (
            placed(),
            (node("n1", "a"), node("n2", "b")),
            "all machines that it may run on have taints: n1 (a=yes:NoSchedule),"
            " n2 (b=yes:NoSchedule); `kubectl taint node n1 a-` removes one",
        ),
        (placed(), (node("n1", "a"), node("n2")), None),
        (
            placed({"cpu": "20"}),
            (SMALL, LARGE),
            "it requests 20 of cpu, and the largest machine that it may run on, large, has 4",
        ),
        (
            placed({"nvidia.com/gpu": "1"}),
            (SMALL, LARGE),
            "it requests 1 of nvidia.com/gpu, which no machine that it may run on has",
        ),
        (
            placed({"cpu": "3", "memory": "2Gi"}),
            (SMALL, LARGE),
            "no machine that it may run on has all that it requests: 3 of cpu, 2Gi of memory",
        ),
        (placed({"cpu": "3"}), (SMALL, LARGE), None),
        (placed({"cpu": "20"}), (SMALL, node("unknown")), None),
    ],
)
def test_why_no_machine_can_run_it(workload: Any, nodes: Any, text: str | None) -> None:
    """One reason, with the way out."""
    found = [one.text for one in find_homeless([workload], nodes)]
    assert found == ([] if text is None else [text])


def test_a_tainted_machine_is_one_message_before_any_write(fake: Any, report: Any) -> None:
    """From the one answer that places, architectures and the preflight share."""
    fake.create(node("n1", "camera", robot="arm"))
    fake.calls.clear()
    remedies = {"taint": "or tolerate it"}
    with pytest.raises(Refused) as caught:
        deploy(desired(placed(robot="arm"), remedies=remedies), fake, report=report)
    [text] = caught.value.details
    assert text.startswith("Deployment n/talker: the only machine")
    assert text.endswith("; or tolerate it")
    assert fake.writes == []


def test_who_may_not_list_machines_may_deploy(fake: Any) -> None:
    """Rights in one namespace are enough."""

    class Blind(type(fake)):  # type: ignore[misc]
        def nodes(self) -> Any:
            raise ClusterError("forbidden")

    fake.create(node("n1"))
    assert diff(desired(placed(robot="leg")), Blind(fake.store)).changes
