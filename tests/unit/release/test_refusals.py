"""Refusals of API servers, several at once: all are named before anything is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release.types import Desired
from tests.support.fake_cluster import FakeCluster, cause, make_refusal
from tests.support.manifests import RELEASE, claim, config, make, workload
from tests.support.releases import deploy

RIVAL = {**config("rival"), "data": {"a": "theirs"}}


@attrs.frozen
class Answer:
    """What the API server answers to whatever writes one object.

    Attributes:
        causes: (field, message), as the answer lists them.
    """

    status: int
    message: str
    causes: Sequence[tuple[str, str]] = ()


def invalid(*causes: tuple[str, str]) -> Answer:
    return Answer(422, "x is invalid", causes)


def denied(message: str) -> Answer:
    return Answer(403, message)


SELECTOR = ("spec.selector", "Invalid value: {}: field is immutable")
STRATEGY = ("spec.strategy.rollingUpdate", "Forbidden: may not be specified when Recreate")
IMAGE = ("spec.template.spec.containers[0].image", "Required value")
PORT = ("spec.template.spec.containers[0].ports[0].containerPort", "Invalid value: 0")
LABEL = ("metadata.labels", "Invalid value: no label")
FIXED = ("spec", "Forbidden: spec is immutable after creation except resources.requests")
TEMPLATE = ("spec.template", "Invalid value: {}: field is immutable")
SECURITY = denied('pods "talker-1" is forbidden: violates PodSecurity "restricted:latest": root')
POLICY = denied("ValidatingAdmissionPolicy 'b' denied request: no team")
LARGE = denied('pods "t" is forbidden: maximum cpu usage per Container is 1, but limit is 2')

#: Objects that are there, by (kind, name) what is answered, and what the error names.
Case = tuple[Sequence[str], Mapping[tuple[str, str], Answer], Sequence[str]]
CASES: Mapping[str, Case] = {
    "three fields, one without a name": (
        (),
        {("Deployment", "talker"): invalid(IMAGE, ("", "and more"), LABEL)},
        ["Required value", "and more", "metadata.labels: Invalid value: no label"],
    ),
    "no cause at all": ((), {("ConfigMap", "c"): invalid()}, ["ConfigMap n/c", "x is invalid"]),
    "all three": (
        ("talker",),
        {("Deployment", "talker"): invalid(IMAGE, STRATEGY, SELECTOR)},
        ["never changes which pods", "image: Required value", "!may not be specified"],
    ),
    "a job's pods and a label": (
        ("j",),
        {("Job", "j"): invalid(TEMPLATE, LABEL)},
        ["spec.template: ", "metadata.labels: Invalid value: no label"],
    ),
    "a claim's size, class and label": (
        ("data",),
        {("PersistentVolumeClaim", "data"): invalid(FIXED, LABEL)},
        ["cannot go from 2Gi to 1Gi", "storageClassName slow", "no label"],
    ),
    "an object and its pod": (
        (),
        {("Deployment", "talker"): invalid(LABEL), ("Pod", "talker"): SECURITY},
        ["no label", "violates PodSecurity"],
    ),
    "two pods for two reasons": (
        (),
        {("Pod", "talker"): SECURITY, ("Pod", "listener"): LARGE},
        ["violates PodSecurity", "maximum cpu usage", "Deployment n/talker", "n/listener"],
    ),
    "two causes of one pod": (
        (),
        {("Pod", "talker"): invalid(("spec.nodeName", "no such machine"), ("", "too many"))},
        ["spec.nodeName: no such machine", "too many"],
    ),
    "a kind that is missing, and a field": (
        (),
        {
            ("Job", "j"): Answer(404, "the server could not find it"),
            ("ConfigMap", "c"): invalid(LABEL),
        },
        ["Job n/j", "could not find it", "no label"],
    ),
    "another manager's object, and a field": (
        ("rival",),
        {("Deployment", "talker"): invalid(IMAGE)},
        ["Required value", "ConfigMap n/rival already exists, made by kubectl", "--adopt"],
    ),
    "four objects": (
        ("talker", "data"),
        {
            ("Deployment", "talker"): invalid(SELECTOR, PORT),
            ("PersistentVolumeClaim", "data"): invalid(FIXED),
            ("Pod", "listener"): LARGE,
            ("ConfigMap", "c"): POLICY,
        },
        ["never changes which pods", "containerPort", "from 2Gi to 1Gi", "cpu usage", "no team"],
    ),
}


def store_claim(size: str, storage_class: str) -> dict[str, Any]:
    return claim(storageClassName=storage_class, resources={"requests": {"storage": size}})


WANTED = (
    workload(),
    workload("listener"),
    config("c"),
    {**RIVAL, "data": {"a": "ours"}},
    store_claim("1Gi", "fast"),
    make(
        "PersistentVolume", "v", spec={"capacity": {"storage": "1Gi"}, "hostPath": {"path": "/b"}}
    ),
    make("Job", "j", spec={"template": {"metadata": {}, "spec": {"containers": []}}}),
)
BEFORE = {
    "talker": workload(image="app:0"),
    "data": store_claim("2Gi", "slow"),
    "v": make("PersistentVolume", "v", spec={"capacity": {"storage": "1Gi"}}),
    "j": make(
        "Job",
        "j",
        spec={
            "suspend": True,
            "template": {"metadata": {}, "spec": {"containers": [{"name": "a"}]}},
        },
    ),
}


def answer(answers: Mapping[tuple[str, str], Answer]) -> Any:
    """Return an API server that refuses some objects."""

    def refuse(live: Any, dry_run: bool) -> Refusal | None:  # noqa: FBT001
        meta = live["metadata"]
        name = meta.get("generateName", "").rstrip("-") or meta["name"]
        found = answers.get((live["kind"], name))
        if found is None:
            return None
        causes = [cause("FieldValueInvalid", text, field) for field, text in found.causes]
        return make_refusal(f"apply {live['kind']} {name}", found.status, "", found.message, causes)

    return refuse


@pytest.mark.parametrize("case", CASES)
def test_every_cause_is_named_before_anything_is_written(
    fake: FakeCluster, report: Any, case: str
) -> None:
    """One that is none, with a `!` here, is not."""
    there, answers, words = CASES[case]
    for name in ("fast", "slow"):
        fake.create(make("StorageClass", name))
    ours = tuple(BEFORE[name] for name in there if name in BEFORE)
    if ours:
        deploy(Desired(RELEASE, ours), fake, report=report)
    if "rival" in there:
        fake.as_manager("kubectl").create(RIVAL)
    wanted = [one for one in WANTED if "rival" in there or ref_of(one) != ref_of(RIVAL)]
    fake.store.refuse = answer(answers)
    before = list(fake.writes)
    with pytest.raises(RigelK8sError) as caught:
        deploy(Desired(RELEASE, tuple(wanted)), fake, report=report)
    text = "\n".join([caught.value.message, *caught.value.details])
    for word in words:
        assert (word.removeprefix("!") in text) is not word.startswith("!"), text
    assert "nothing was changed" in text
    assert fake.writes == before
