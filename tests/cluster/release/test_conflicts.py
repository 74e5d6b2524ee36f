"""What others own: conflicts are named, adopted when asked for, refused between releases."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import ConflictError
from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.drift import describe_drift
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.releases import deploy, diff, down

pytestmark = pytest.mark.cluster


def apply_as(cluster: Any, manager: str, manifest: dict[str, Any], **query: str) -> dict[str, Any]:
    """Apply a manifest as another tool does."""
    ref = ref_of(manifest)
    url = cluster.client.path_of(ref, "test", query={"fieldManager": manager, **query})
    media = "application/apply-patch+yaml"
    made: dict[str, Any] = cluster.client.call(
        "PATCH", url, "test", read_mapping, body=manifest, media=media
    )
    return made


def test_a_changed_field_of_another_manager_is_a_conflict_that_names_both(
    cluster: Any, make: Any, report: Any
) -> None:
    """Somebody's scale of a Deployment is not undone without a word; --adopt undoes it."""
    wanted = make.desired(make.deployment(replicas=0))
    deploy(wanted, cluster, report=report)
    theirs = make.deployment(replicas=0)
    theirs["spec"] = {"revisionHistoryLimit": 3, "replicas": 0}
    apply_as(cluster, "argo", theirs)
    ours = make.deployment(replicas=0)
    ours["spec"]["revisionHistoryLimit"] = 5
    with pytest.raises(ConflictError) as caught:
        deploy(make.desired(ours), cluster, report=report)
    assert "argo owns .spec.revisionHistoryLimit" in caught.value.details[0]
    assert "--adopt" in (caught.value.hint or "")
    deploy(make.desired(ours), cluster, report=report, adopt=True)
    live = cluster.get(ObjectRef("apps/v1", "Deployment", make.namespace, "talker"))
    assert live["spec"]["revisionHistoryLimit"] == 5


def test_a_partial_conflict_changes_nothing_at_all(cluster: Any, make: Any, report: Any) -> None:
    """One conflict among several objects: none of them is written."""
    deploy(make.desired(make.config("a", k="1"), make.config("b", k="1")), cluster, report=report)
    theirs = make.config("b", k="theirs")
    apply_as(cluster, "argo", theirs, force="true")
    with pytest.raises(ConflictError):
        deploy(
            make.desired(make.config("a", k="2"), make.config("b", k="2")), cluster, report=report
        )
    live = cluster.get(ObjectRef("v1", "ConfigMap", make.namespace, "a"))
    assert live["data"] == {"k": "1"}


def test_an_edited_field_is_seen_though_the_rigelfile_has_not_changed(
    cluster: Any, make: Any, report: Any
) -> None:
    """A hash alone would call an edited object unchanged; ownership tells."""
    wanted = make.desired(make.config(a="1"))
    deploy(wanted, cluster, report=report)
    ref = ObjectRef("v1", "ConfigMap", make.namespace, "config")
    url = cluster.client.path_of(ref, "test", query={"fieldManager": "kubectl-edit"})
    media = "application/merge-patch+json"
    cluster.client.call(
        "PATCH", url, "test", read_mapping, body={"data": {"a": "edited"}}, media=media
    )
    with pytest.raises(ConflictError, match="managed by others") as caught:
        diff(wanted, cluster)
    assert "kubectl-edit owns .data.a" in caught.value.details[0]
    deploy(wanted, cluster, report=report, adopt=True)
    assert cluster.get(ref)["data"] == {"a": "1"}


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


def test_an_object_that_is_not_ours_is_adopted_only_when_asked(
    cluster: Any, make: Any, report: Any
) -> None:
    """What kubectl made becomes ours with --adopt: what it had set and we do not say goes away."""
    theirs = make.config(a="1", extra="theirs")
    apply_as(cluster, "kubectl", theirs)
    wanted = make.desired(make.config(a="1"))
    with pytest.raises(ConflictError) as caught:
        deploy(wanted, cluster, report=report)
    assert "made by kubectl" in caught.value.details[0]
    deploy(wanted, cluster, report=report, adopt=True)
    ref = ObjectRef("v1", "ConfigMap", make.namespace, "config")
    assert cluster.get(ref)["data"] == {"a": "1"}
    assert diff(wanted, cluster).changes == ()
    down(cluster, make.release, volumes=False, report=report)
    assert cluster.get(ref) is None


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


def test_a_cluster_wide_volume_of_a_namesake_in_another_namespace_is_refused(
    admin: Any, make: Any, report: Any
) -> None:
    """The same release name in two namespaces: a volume belongs to one of them."""
    volume = make.volume(f"v-{make.namespace}", "/tmp/rigel-k8s-test")
    deploy(make.desired(volume), admin, report=report)
    other = Desired(ReleaseId("default", "demo"), (volume,))
    with pytest.raises(Refused, match="nothing was changed"):
        deploy(other, admin, report=report)


def test_a_rolling_deployment_of_another_tool_is_taken_over_as_recreate(
    cluster: Any, make: Any, report: Any
) -> None:
    """What kubectl made has Kubernetes' own rolling defaults, which Recreate forbids."""
    theirs = make.deployment(replicas=0)
    theirs["spec"].pop("strategy", None)
    cluster.client.call(
        "POST",
        f"/apis/apps/v1/namespaces/{make.namespace}/deployments?fieldManager=kubectl-create",
        "test",
        read_mapping,
        body=theirs,
    )
    ours = make.deployment(replicas=0)
    ours["spec"]["strategy"] = {"type": "Recreate"}
    with pytest.raises(ConflictError):
        deploy(make.desired(ours), cluster, report=report)
    deploy(make.desired(ours), cluster, report=report, adopt=True)
    live = cluster.get(ObjectRef("apps/v1", "Deployment", make.namespace, "talker"))
    assert live["spec"]["strategy"] == {"type": "Recreate"}
    assert not diff(make.desired(ours), cluster).changes


def test_a_strategy_may_change_to_recreate_and_back(cluster: Any, make: Any, report: Any) -> None:
    """Recreate needs a patch of its own, whose owner is no other manager than the deploy's."""
    for kind in ("RollingUpdate", "Recreate", "RollingUpdate"):
        wanted = make.deployment(replicas=0)
        wanted["spec"]["strategy"] = {"type": kind}
        deploy(make.desired(wanted), cluster, report=report)
        live = cluster.get(ObjectRef("apps/v1", "Deployment", make.namespace, "talker"))
        assert live["spec"]["strategy"]["type"] == kind
