"""Why an object is refused, in words that say what to do; who else owns what is written."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_k8s.kube.failures import Conflict, Missing, refusal
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release.labelling import manifests_to_apply
from rigel_k8s.release.refusals.foresight import Foreseen
from rigel_k8s.release.refusals.verdict import Refused, check, explain, find_conflicts, find_unowned
from rigel_k8s.release.survey import Survey
from rigel_k8s.release.types import Desired, InventoryItem, ReleaseId, Revision
from tests.support.manifests import RELEASE, claim, config, desired, make
from tests.support.releases import deploy

IMMUTABLE = ("spec", "field is immutable after creation")


def sized(size: str, **spec: Any) -> dict[str, Any]:
    return claim("x", resources={"requests": {"storage": size}}, **spec)


@pytest.mark.parametrize(
    ("live", "wanted", "cause", "words"),
    [
        (sized("2Gi"), sized("1Gi"), IMMUTABLE, "a claim cannot go from 2Gi to 1Gi"),
        (
            sized("1Gi", storageClassName="a"),
            sized("1Gi", storageClassName="b"),
            IMMUTABLE,
            "it exists with storageClassName a, the Rigelfile now has storageClassName b",
        ),
        (sized("1Gi"), sized("1Gi"), ("spec.x", "no"), "spec.x: no"),
        (
            make("PersistentVolume", "x", spec={}),
            make("PersistentVolume", "x", spec={}),
            IMMUTABLE,
            "Kubernetes never changes where a volume's data are",
        ),
        (
            make("Deployment", "x", spec={}),
            make("Deployment", "x", spec={}),
            ("spec.selector", "field is immutable"),
            "Kubernetes never changes which pods a Deployment selects",
        ),
        (
            make("StatefulSet", "x", spec={}),
            make("StatefulSet", "x", spec={}),
            ("spec", "Forbidden: updates to statefulset spec for fields other than"),
            "or delete it first: kubectl -n n delete statefulset x",
        ),
        (None, make("Job", "x", spec={}), IMMUTABLE, "spec: field is immutable after creation"),
    ],
)
def test_what_cannot_change_has_a_way_out(
    live: Any, wanted: Any, cause: tuple[str, str], words: str
) -> None:
    """In our own words where we know better than Kubernetes."""
    causes = [{"reason": "FieldValueInvalid", "field": cause[0], "message": cause[1]}]
    body = json.dumps({"message": "no", "details": {"causes": causes}}).encode()
    error = refusal(422, body, "apply", context="c", server="s")
    assert words in explain(ref_of(wanted), error, live, wanted)


def surveyed(results: dict[Any, Any], live: list[dict[str, Any]], uid: str = "") -> Survey:
    """Return what a deploy of ConfigMap c finds."""
    wanted = desired(config())
    items = (InventoryItem(ref_of(config()), uid),)
    last = Revision(RELEASE, 1, "good", "", (), items)
    there = {ref_of(one): one for one in live}
    found = Foreseen(results)
    return Survey(wanted, manifests_to_apply(wanted), there, found, {}, [], last)


def test_a_kind_that_the_cluster_does_not_have_is_named_so() -> None:
    with pytest.raises(Refused) as caught:
        check(surveyed({ref_of(config()): Missing("no kind ConfigMap")}, []), adopt=False)
    assert [problem.kind for problem in caught.value.problems] == ["unknown-kind"]


@pytest.mark.parametrize(("uid", "ours"), [("u-1", True), ("u-0", False)])
def test_what_we_made_is_ours_without_its_label(uid: str, ours: Any) -> None:
    """Someone has removed the label: the last revision still knows the object by its UID."""
    live = {**config(), "metadata": {**config()["metadata"], "uid": "u-1"}}
    found = surveyed({ref_of(config()): live}, [live], uid)
    assert (not [*find_unowned(found)]) is ours


def test_an_object_of_the_whole_cluster_names_its_owners_namespace(fake: Any, report: Any) -> None:
    """The robots of a fleet have releases of one name, and a volume of one name at first."""
    volume = make("PersistentVolume", "bags-pv")
    deploy(Desired(RELEASE, (volume,), create_namespace=True), fake, report=report)
    other = Desired(ReleaseId("robot-02", RELEASE.name), (volume,), create_namespace=True)
    with pytest.raises(Refused) as caught:
        deploy(other, fake, report=report)
    (line,) = caught.value.details
    assert f"belongs to another release ({RELEASE.name} in {RELEASE.namespace})" in line


def test_a_conflict_without_fields_has_no_owner_to_name() -> None:
    found = surveyed({ref_of(config()): Conflict("the object has been modified")}, [])
    assert [*find_conflicts(found)] == []
