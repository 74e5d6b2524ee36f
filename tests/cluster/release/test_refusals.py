"""What a real cluster refuses before the first write: pods and missing rights."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.refusals.verdict import Refused
from tests.support.releases import deploy
from tests.support.until import until

pytestmark = pytest.mark.cluster


def put(kind: str, name: str, spec: dict[str, Any]) -> Callable[[Any, str], None]:
    """Return what puts an object into a namespace."""

    def act(admin: Any, namespace: str) -> None:
        meta = {"name": name, "namespace": namespace}
        admin.create({"apiVersion": "v1", "kind": kind, "metadata": meta, "spec": spec})

    return act


def restrict(admin: Any, namespace: str) -> None:
    labels = {"pod-security.kubernetes.io/enforce": "restricted"}
    ref = ObjectRef("v1", "Namespace", "", namespace)
    admin.patch(ref, {"metadata": {"labels": labels}})


def try_pod(admin: Any, make: Any) -> str:
    """Return why the API server refuses a pod: it hears by watches of what else there is."""
    template = make.deployment("try", **GREEDY)["spec"]["template"]
    meta = {**template["metadata"], "name": "try", "namespace": make.namespace}
    try:
        admin.create(
            {"apiVersion": "v1", "kind": "Pod", **template, "metadata": meta}, dry_run=True
        )
    except Refusal as error:
        return error.words
    return ""


LIMITS = {"limits": [{"type": "Container", "max": {"cpu": "1"}}]}
GREEDY = {"resources": {"requests": {"cpu": "2"}, "limits": {"cpu": "2"}}}


@pytest.mark.parametrize(
    ("prepare", "kind", "words"),
    [
        (restrict, "pod-security", 'violates PodSecurity "restricted:latest"'),
        (put("LimitRange", "low", LIMITS), "limit-range", "maximum cpu usage per Container is 1"),
        (
            put("ResourceQuota", "said", {"hard": {"limits.memory": "1Gi"}}),
            "no-resources",
            "must specify limits.memory",
        ),
    ],
)
def test_refused_pods_are_known_before_any_write(
    cluster: Any,
    admin: Any,
    make: Any,
    report: Any,
    prepare: Callable[[Any, str], None],
    kind: str,
    words: str,
) -> None:
    """With the workload's place; nothing of the release is there afterwards."""
    prepare(admin, make.namespace)
    until(lambda: words in try_pod(admin, make), f"refusal of pods: {words}", 120)
    nodes = make.deployment("talker", **GREEDY), make.deployment("listener", **GREEDY)
    wanted = make.desired(*nodes, origins={ref_of(nodes[0]): ("nodes", "talker")})

    def refuse() -> Refused:
        with pytest.raises(Refused) as caught:
            deploy(wanted, cluster, report=report)
        return caught.value

    [problem] = refuse().problems
    assert (problem.path, problem.kind) == (("nodes", "talker"), kind)
    assert words in problem.message
    assert "Deployment" in problem.message
    for version, name in (("apps/v1", "Deployment"), ("v1", "Secret")):
        assert admin.list(version, name, make.namespace) == []


def test_all_missing_rights_are_one_list(cluster: Any, admin: Any, make: Any, report: Any) -> None:
    """Without the Role nothing is allowed; with a part of it, what is missing is listed."""
    role = ObjectRef("rbac.authorization.k8s.io/v1", "Role", make.namespace, "rigel-deployer")
    rules = admin.get(role)["rules"]
    kept = [{**rule, "verbs": [v for v in rule["verbs"] if v != "patch"]} for rule in rules]
    admin.patch(role, {"rules": kept})
    wanted = make.desired(make.config(a="1"), make.deployment())

    def is_refused() -> bool:
        try:
            cluster.apply(make.config(a="1"), dry_run=True)
        except Forbidden:
            return True
        return False

    until(is_refused, "the Role without patch")  # until then a deploy would be made

    def find_missing() -> tuple[str, ...]:
        with pytest.raises(ClusterError) as caught:
            deploy(wanted, cluster, report=report)
        assert isinstance(caught.value, Forbidden)
        return caught.value.details

    lines = (
        "configmaps: patch",
        "secrets: patch",
        "deployments.apps: patch",
        "leases.coordination.k8s.io: patch",
    )
    until(lambda: find_missing() == lines, "the Role without patch")
    assert admin.list("coordination.k8s.io/v1", "Lease", make.namespace) == []
