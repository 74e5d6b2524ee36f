"""No data is lost: claims outlive a `down`, and what Kubernetes forbids is explained before."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.refusals.verdict import Refused
from tests.support.releases import deploy, down

pytestmark = pytest.mark.cluster


def with_claim(make: Any) -> dict[str, Any]:
    volume = {"name": "data", "persistentVolumeClaim": {"claimName": "data"}}
    found: dict[str, Any] = make.deployment(
        "keeper",
        pod={"volumes": [volume]},
        volumeMounts=[{"name": "data", "mountPath": "/data"}],
    )
    return found


def pod_of(cluster: Any, make: Any) -> str:
    labels = {"app.kubernetes.io/name": "keeper"}
    pods = cluster.list("v1", "Pod", make.namespace, labels=labels)
    return str(pods[0]["metadata"]["name"])


def test_data_outlives_down_unless_volumes_are_asked_for(
    cluster: Any, make: Any, report: Any
) -> None:
    """A file in a claim is there again after down and deploy; --volumes removes the claim."""
    wanted = make.desired(make.claim(), with_claim(make))
    deploy(wanted, cluster, report=report)
    write = ["sh", "-c", "echo kept > /data/file"]
    assert cluster.run(make.namespace, pod_of(cluster, make), write).code == 0
    plan = down(cluster, make.release, volumes=False, report=report)
    assert ("forget", "data") in {(s.action, s.ref.name) for s in plan.steps}
    ref = ObjectRef("v1", "PersistentVolumeClaim", make.namespace, "data")
    assert cluster.get(ref) is not None
    deploy(wanted, cluster, report=report)
    read = cluster.run(make.namespace, pod_of(cluster, make), ["cat", "/data/file"])
    assert read.stdout == b"kept\n"
    down(cluster, make.release, volumes=False, report=report)
    down(cluster, make.release, volumes=True, report=report)
    assert cluster.get(ref) is None


def test_all_claims_are_waited_for_at_once(cluster: Any, make: Any, report: Any) -> None:
    """Those that something holds are told together, each with what holds it."""
    names = ("maps", "bags")
    deploy(make.desired(*map(make.claim, names)), cluster, report=report)
    refs = [ObjectRef("v1", "PersistentVolumeClaim", make.namespace, name) for name in names]
    for ref in refs:
        cluster.patch(ref, {"metadata": {"finalizers": [f"test.example/{ref.name}"]}})
    with pytest.raises(ClusterError, match=r"2 object\(s\) still exist after 1 s") as caught:
        down(cluster, make.release, volumes=True, report=report, timeout=1)
    told = "\n".join(caught.value.details)
    assert all(f"{name}: test.example/{name}" in told for name in names)
    for ref in refs:
        cluster.patch(ref, {"metadata": {"finalizers": None}})
    down(cluster, make.release, volumes=True, report=report)
    assert not any(map(cluster.get, refs))


@pytest.mark.parametrize(
    ("size", "storage_class", "message"),
    [
        ("16Mi", None, "cannot go from 32Mi to 16Mi: it never shrinks"),
        ("32Mi", "fast", "the Rigelfile now has storageClassName fast"),
    ],
)
def test_what_cannot_change_of_a_claim_is_refused_before_anything_is_applied(
    cluster: Any, make: Any, report: Any, size: str, storage_class: str | None, message: str
) -> None:
    """The refusal explains, names the way out, and nothing else of the deploy is written.

    The claim has its volume, which it gets with its first pod: without one it is made anew.
    """
    keeper = with_claim(make)
    deploy(make.desired(make.claim(), keeper, make.config(a="1")), cluster, report=report)
    changed = make.claim(size=size, storage_class=storage_class)
    ref = ObjectRef("v1", "PersistentVolumeClaim", make.namespace, "data")
    origins = {ref: ("volumes", 0)}
    wanted = make.desired(changed, keeper, make.config(a="2"), origins=origins)
    with pytest.raises(Refused) as caught:
        deploy(wanted, cluster, report=report)
    assert message in caught.value.details[0]
    assert "kubectl -n" in caught.value.details[0]
    assert caught.value.problems[0].path == ("volumes", 0)
    config = cluster.get(ObjectRef("v1", "ConfigMap", make.namespace, "config"))
    assert config["data"] == {"a": "1"}


def test_a_claim_without_a_volume_is_made_anew_with_what_changes(
    cluster: Any, make: Any, report: Any
) -> None:
    """It holds no data: what Kubernetes never changes of it does not keep a user waiting."""
    deploy(make.desired(make.claim()), cluster, report=report)
    ref = ObjectRef("v1", "PersistentVolumeClaim", make.namespace, "data")
    before = cluster.get(ref)
    if before["status"]["phase"] != "Pending":
        pytest.skip("the storage class makes volumes before a pod needs them")
    deploy(make.desired(make.claim(size="16Mi")), cluster, report=report)
    after = cluster.get(ref)
    assert after["metadata"]["uid"] != before["metadata"]["uid"]
    assert after["spec"]["resources"]["requests"]["storage"] == "16Mi"


def test_other_immutable_fields_are_explained_all_at_once(
    admin: Any, make: Any, report: Any
) -> None:
    """Selector and volume source: each with what it means, in one refusal; a Job is no obstacle."""
    name = f"v-{make.namespace}"
    job = {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": "once", "namespace": make.namespace},
        "spec": {
            "suspend": True,
            "template": {
                "spec": {
                    "restartPolicy": "Never",
                    "containers": [{"name": "c", "image": make.image, "command": ["true"]}],
                }
            },
        },
    }
    deployment = make.deployment(replicas=0)
    deploy(make.desired(make.volume(name, "/tmp/one"), job, deployment), admin, report=report)
    job = {
        **job,
        "spec": {
            **job["spec"],
            "template": {
                "spec": {
                    "restartPolicy": "Never",
                    "containers": [{"name": "c", "image": make.image, "command": ["false"]}],
                }
            },
        },
    }
    deployment = make.deployment(replicas=0)
    deployment["spec"]["selector"]["matchLabels"]["more"] = "x"
    deployment["spec"]["template"]["metadata"]["labels"]["more"] = "x"
    with pytest.raises(Refused) as caught:
        deploy(make.desired(make.volume(name, "/tmp/two"), job, deployment), admin, report=report)
    told = "\n".join(caught.value.details)
    assert "never changes where a volume's data are" in told
    assert "once" not in told, "a changed Job is deleted and made anew"
    assert "never changes which pods a Deployment selects" in told
