"""A prometheus-operator that is there takes our PodMonitors and rules: no second stack."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.objects.scalars import LabelKey, LabelValue
from rigel_k8s.observability.options import Existing, ExistingPrometheus, Loki, Observability
from rigel_k8s.release.types import Desired
from rigel_lab.cluster.addons import IMAGES
from rigel_stack import boards
from rigel_stack.manifests.desired import stack_release
from rigel_stack.manifests.stack import Boards
from rigel_stack.manifests.stack import Stack as StackParts
from tests.support.recorder import Recorder
from tests.support.releases import deploy

from ..conftest import wait_for_account
from .conftest import Stack, until

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("more_images")]

LABELS = {"release": "theirs"}
ACCOUNT = "theirs"


def prometheus(namespace: str) -> list[dict[str, Any]]:
    """A Prometheus of the operator's, which selects by the label `release`."""
    chosen = {"matchLabels": LABELS}
    role = {
        "apiVersion": "rbac.authorization.k8s.io/v1",
        "kind": "ClusterRole",
        "metadata": {"name": namespace},
        "rules": [{"apiGroups": [""], "resources": ["pods"], "verbs": ["get", "list", "watch"]}],
    }
    subject = {"kind": "ServiceAccount", "name": ACCOUNT, "namespace": namespace}
    reference = {"apiGroup": "rbac.authorization.k8s.io", "kind": "ClusterRole", "name": namespace}
    return [
        {
            "apiVersion": "v1",
            "kind": "ServiceAccount",
            "metadata": {"name": ACCOUNT, "namespace": namespace},
        },
        role,
        {
            "apiVersion": role["apiVersion"],
            "kind": "ClusterRoleBinding",
            "metadata": role["metadata"],
            "roleRef": reference,
            "subjects": [subject],
        },
        {
            "apiVersion": "monitoring.coreos.com/v1",
            "kind": "Prometheus",
            "metadata": {"name": "theirs", "namespace": namespace},
            "spec": {
                "image": IMAGES["prometheus"],
                "version": IMAGES["prometheus"].rpartition(":")[2],
                "serviceAccountName": ACCOUNT,
                "podMonitorSelector": chosen,
                "podMonitorNamespaceSelector": {},
                "ruleSelector": chosen,
                "scrapeInterval": "5s",
                "evaluationInterval": "5s",
            },
        },
    ]


def robot(namespace: str) -> dict[str, Any]:
    """A pod of a release that asks to be scraped: any program with metrics will do."""
    labels = {"rigel-k8s/release": "demo", "app.kubernetes.io/name": "camera"}
    asked = {"prometheus.io/scrape": "true", "prometheus.io/port": "9090"}
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {
            "name": "camera",
            "namespace": namespace,
            "labels": labels,
            "annotations": {**asked, "rigel-k8s/ros-name": "/camera"},
        },
        "spec": {"containers": [{"name": "ros-node", "image": IMAGES["prometheus"]}]},
    }


def ours(namespace: str) -> Desired:
    """What we bring to such a cluster, beside a collector."""
    labels = {LabelKey(key): LabelValue(value) for key, value in LABELS.items()}
    existing = Existing(prometheus=ExistingPrometheus(labels=labels), grafana=True)
    options = Observability(enabled=True, existing=existing, loki=Loki(enabled=False))
    texts = Boards(boards.dashboards(), boards.rules())
    return stack_release(StackParts(options, namespace, texts), {})


@pytest.fixture(scope="module")
def operated(cluster: Any, prometheus_operator: None) -> Iterator[str]:
    """A namespace with a Prometheus of the operator's, our monitors and a pod to be scraped."""
    namespace = f"t-existing-{uuid.uuid4().hex[:6]}"
    space = {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": namespace}}
    theirs = [space, *prometheus(namespace), robot(namespace)]
    for item in theirs:
        cluster.apply(item)
        if item is space:
            wait_for_account(cluster, namespace)
    deploy(ours(namespace), cluster, report=Recorder())
    yield namespace
    for item in reversed(theirs):
        cluster.delete(ref_of(item))


def asked(cluster: Any, namespace: str, path: str, **query: object) -> Any:
    """What their Prometheus answers; nothing where it does not yet."""
    stack = Stack(cluster, "", namespace, Path())
    try:
        return stack.ask("prometheus-operated", 9090, f"api/v1/{path}", **query)
    except ClusterError:
        return {}


def test_their_prometheus_scrapes_our_pods(cluster: Any, operated: str) -> None:
    """With the labels of the contract, in the job that our dashboards and rules ask for."""
    query = f'up{{job="pods", namespace="{operated}", application="demo"}}'

    def up() -> Any:
        """The pod's sample: 0 until it answers."""
        found = asked(cluster, operated, "query", query=query).get("result", [])
        return found if any(one["value"][1] == "1" for one in found) else None

    (sample,) = until(up, "the pod is scraped")
    metric = sample["metric"]
    assert (metric["ros_node"], metric["workload"]) == ("/camera", "camera")
    assert (metric["pod"], metric["container"]) == ("camera", "ros-node")


def test_their_prometheus_has_our_rules(cluster: Any, operated: str) -> None:
    """All of them, and each can be evaluated."""
    wanted = {
        group["name"]
        for text in boards.rules().values()
        for group in yaml.safe_load(text)["groups"]
    }

    def healthy() -> bool:
        groups = asked(cluster, operated, "rules").get("groups") or []
        states = {rule["health"] for group in groups for rule in group["rules"]}
        return wanted <= {group["name"] for group in groups} and states == {"ok"}

    assert wanted
    until(healthy, "our rules are evaluated")
