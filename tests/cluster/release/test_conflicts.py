"""What others own: named and adopted when asked for, refused between releases."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.drift import describe_drift
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.releases import deploy, diff

pytestmark = pytest.mark.cluster


def test_what_others_add_is_named_and_removed_by_adopt(
    cluster: Any, make: Any, report: Any
) -> None:
    """As `kubectl patch` leaves it; of a `kubectl scale` of what we leave out no trace is kept."""
    made = make.deployment()
    del made["spec"]["replicas"]
    wanted = make.desired(made)
    deploy(wanted, cluster, report=report)
    ref = ref_of(made)
    url = cluster.client.path_of(ref, "test", query={"fieldManager": "kubectl-patch"})
    media = "application/merge-patch+json"
    body = {"spec": {"replicas": 0}}
    cluster.client.call("PATCH", url, "test", read_mapping, body=body, media=media)
    assert describe_drift(cluster.get(ref)) == ["was changed by kubectl-patch: replicas 0"]
    assert diff(wanted, cluster).changes == ()
    deploy(wanted, cluster, report=report, adopt=True)
    live = cluster.get(ref)
    assert (live["spec"]["replicas"], describe_drift(live)) == (1, [])
    assert diff(wanted, cluster, adopt=True).changes == ()


def test_another_releases_object_is_refused_even_with_adopt(
    cluster: Any, make: Any, report: Any
) -> None:
    """Two releases write as one manager, so Kubernetes would see no conflict; we do."""
    deploy(make.desired(make.config(a="1")), cluster, report=report)
    other = Desired(ReleaseId(make.namespace, "other"), (make.config(a="2"),))
    with pytest.raises(Refused, match="nothing was changed") as caught:
        deploy(other, cluster, report=report, adopt=True)
    assert "belongs to another release (demo)" in caught.value.details[0]
    assert caught.value.problems[0].kind == "other-release"
    live = cluster.get(ObjectRef("v1", "ConfigMap", make.namespace, "config"))
    assert live["data"] == {"a": "1"}
    assert live["metadata"]["labels"][RELEASE_LABEL] == "demo"


def test_a_strategy_may_change_to_recreate_and_back(cluster: Any, make: Any, report: Any) -> None:
    """Recreate needs a patch of its own, whose owner is no other manager than the deploy's."""
    for kind in ("RollingUpdate", "Recreate", "RollingUpdate"):
        wanted = make.deployment(replicas=0)
        wanted["spec"]["strategy"] = {"type": kind}
        deploy(make.desired(wanted), cluster, report=report)
        live = cluster.get(ObjectRef("apps/v1", "Deployment", make.namespace, "talker"))
        assert live["spec"]["strategy"]["type"] == kind
