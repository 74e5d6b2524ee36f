"""What pods name and does not exist, and claims that were never filled."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release.refusals.verdict import Refused
from tests.support.controllers import STATUSES
from tests.support.fake_cluster import make_refusal
from tests.support.manifests import claim, config, desired, make, ref, workload
from tests.support.releases import deploy


def using(**spec: Any) -> dict[str, Any]:
    made = workload()
    made["spec"]["template"]["spec"] |= spec
    return made


def volume(**source: Any) -> dict[str, Any]:
    return using(volumes=[{"name": "v", **source}])


def environment(**container: Any) -> dict[str, Any]:
    made = workload()
    made["spec"]["template"]["spec"]["containers"][0] |= container
    return made


MAP = {"name": "calibration"}


@pytest.mark.parametrize(
    ("manifest", "kind"),
    [
        (volume(configMap=MAP), "ConfigMap calibration"),
        (volume(secret={"secretName": "keys"}), "Secret keys"),
        (volume(persistentVolumeClaim={"claimName": "maps"}), "PersistentVolumeClaim maps"),
        (volume(projected={"sources": [{"configMap": MAP}]}), "ConfigMap calibration"),
        (environment(envFrom=[{"configMapRef": MAP}]), "ConfigMap calibration"),
        (environment(envFrom=[{"secretRef": {"name": "keys"}}]), "Secret keys"),
        (environment(envFrom=[{"secretRef": {"name": "keys", "optional": True}}]), None),
        (
            environment(env=[{"name": "A", "valueFrom": {"secretKeyRef": {"name": "keys"}}}]),
            "Secret keys",
        ),
        (volume(configMap={**MAP, "optional": True}), None),
        (volume(configMap={"name": "c"}), None),  # the release brings it
        (volume(configMap={"name": "kube-root-ca.crt"}), None),
    ],
)
def test_what_does_not_exist_is_refused(
    fake: Any, report: Any, manifest: Any, kind: str | None
) -> None:
    """Before the first write, and not after a minute of waiting for the pod."""
    wanted = desired(manifest, config(), remedies={"missing-object": "create it"})
    if kind is None:
        deploy(wanted, fake, report=report)
        return
    with pytest.raises(Refused) as caught:
        deploy(wanted, fake, report=report)
    assert caught.value.details == (
        f"Deployment n/talker: the {kind} does not exist in the namespace n; create it",
    )
    assert fake.writes == []
    fake.create({**config("calibration"), "kind": "ConfigMap"})
    fake.create({**config("keys"), "kind": "Secret"})
    fake.create(claim("maps"))
    deploy(wanted, fake, report=report)


def test_what_must_not_be_read_counts_as_existing(fake: Any, report: Any) -> None:
    class Blind(type(fake)):  # type: ignore[misc]
        def get(self, ref: Any) -> Any:
            if ref.kind == "Secret" and ref.name == "keys":
                raise ClusterError("forbidden")
            return super().get(ref)

    wanted = desired(volume(secret={"secretName": "keys"}))
    assert deploy(wanted, Blind(fake.store), report=report).number == 1


def stored(name: str) -> dict[str, Any]:
    return claim(storageClassName=name, resources={"requests": {"storage": "1Gi"}})


def test_a_storage_class_that_does_not_exist_is_refused(fake: Any, report: Any) -> None:
    """Unless volumes were made by hand under its name."""
    with pytest.raises(Refused, match="cannot be deployed") as caught:
        deploy(desired(stored("fast")), fake, report=report)
    assert "the StorageClass fast does not exist" in caught.value.details[0]
    assert fake.writes == []
    fake.create(make("PersistentVolume", "v", spec={"storageClassName": "fast"}))
    deploy(desired(stored("fast")), fake, report=report)


def refuse_changes(fake: Any) -> Any:
    """Return an admission that lets no claim change, as Kubernetes."""

    def refuse(live: Any, dry_run: bool) -> Any:  # noqa: FBT001
        old = fake.objects.get(ref_of(live))
        if live["kind"] != "PersistentVolumeClaim" or old is None or old["spec"] == live["spec"]:
            return None
        return make_refusal("apply", 422, "Invalid", "spec is immutable after creation")

    return refuse


@pytest.mark.parametrize("bound", [False, True])
def test_only_an_empty_claim_is_replaced(
    fake: Any, report: Any, monkeypatch: pytest.MonkeyPatch, *, bound: bool
) -> None:
    """A mistake in its class is corrected by the next deploy; data are never deleted."""
    for name in ("slow", "fast"):
        fake.create(make("StorageClass", name))
    deploy(desired(stored("slow")), fake, report=report)
    old = fake.objects[ref("PersistentVolumeClaim", "data")]["metadata"]["uid"]
    fake.store.refuse = refuse_changes(fake)
    if bound:
        with pytest.raises(Refused) as caught:
            deploy(desired(stored("fast")), fake, report=report)
        assert "it exists with storageClassName slow" in caught.value.details[0]
        return
    monkeypatch.setitem(STATUSES, "PersistentVolumeClaim", lambda live: {"phase": "Pending"})
    fake.patch(ref("PersistentVolumeClaim", "data"), {"status": {"phase": "Pending"}})
    deploy(desired(stored("fast")), fake, report=report)
    live = fake.objects[ref("PersistentVolumeClaim", "data")]
    assert live["metadata"]["uid"] != old
    assert live["spec"]["storageClassName"] == "fast"
