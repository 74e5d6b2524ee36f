"""Revisions that someone changed or made up: an error with the Secret's name, never a traceback."""

from __future__ import annotations

import base64
import gzip
import json
import os
import random
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.release import revisions
from rigel_k8s.release.history import History
from rigel_k8s.release.listing import list_releases
from tests.support.manifests import RELEASE, config, desired, workload
from tests.support.releases import deploy, diff, rollback

LABELS = revisions.NUMBER, revisions.STATUS


def put(fake: Any, change: Callable[[dict[str, Any]], object]) -> None:
    """Deploy, and change the last revision's Secret."""
    [(ref, secret)] = [one for one in fake.objects.items() if one[0].kind == "Secret"]
    change(secret)
    fake.objects[ref] = secret


def content(found: object) -> str:
    """Return content as a Secret holds it."""
    return base64.b64encode(gzip.compress(json.dumps(found).encode())).decode()


WHOLE = {"format": 1, "objects": [], "inventory": [], "options": {}}
BROKEN: dict[str, str] = {
    "corrupt": base64.b64encode(gzip.compress(b"x" * 99)[:-20] + b"y" * 20).decode(),
    "cut": base64.b64encode(gzip.compress(b"x" * 99)[:-20]).decode(),
    "list": content([]),
    "no objects": content({"format": 1, "inventory": [], "options": {}}),
    "text as metadata": content({**WHOLE, "objects": [{"kind": "A", "metadata": "x"}]}),
    "inventory": content({**WHOLE, "inventory": [["v1", "Pod"]]}),
    "options": content({**WHOLE, "options": [1]}),
    "deep": base64.b64encode(gzip.compress(b"[" * 100_000 + b"]" * 100_000)).decode(),
    "large": base64.b64encode(gzip.compress(b" " * (revisions.MAX_CONTENT + 1))).decode(),
    "no base64": "é",
}


@pytest.mark.parametrize("broken", BROKEN)
def test_a_damaged_revision_is_named(fake: Any, report: Any, broken: str) -> None:
    """What needs it fails with the Secret's name; what does not goes on."""
    wanted = desired(workload(), config())
    deploy(wanted, fake, report=report)
    put(fake, lambda secret: secret.update(data={"release": BROKEN[broken]}))
    for use in (lambda: deploy(wanted, fake, report=report), lambda: diff(wanted, fake)):
        with pytest.raises(ClusterError, match=r"revision 1 of demo cannot be read") as caught:
            use()
        assert "delete secret rigel.demo.v1" in str(caught.value.hint)
    assert History().make_entries(revisions.records(fake, RELEASE))[0].status == "good"
    assert [one.status for one in list_releases(fake, None)] == ["good"]


@pytest.mark.parametrize("label", LABELS)
@pytest.mark.parametrize("value", [None, "x", ""])
def test_a_damaged_label_is_named_and_hides_no_other_release(
    fake: Any, report: Any, label: str, value: str | None
) -> None:
    """`list` has a line for each release."""
    deploy(desired(workload()), fake, report=report)
    put(fake, lambda secret: secret["metadata"]["labels"].update({label: value}))
    with pytest.raises(ClusterError, match=f"its label {label} is {value}"):
        revisions.records(fake, RELEASE)
    assert [one.release for one in list_releases(fake, None)] == [RELEASE]


def test_a_damaged_annotation_is_named(fake: Any, report: Any) -> None:
    """That of a rollback."""
    deploy(desired(workload()), fake, report=report)
    put(fake, lambda s: s["metadata"]["annotations"].update({revisions.BACK_TO: "x"}))
    with pytest.raises(ClusterError, match=f"its annotation {revisions.BACK_TO} is x"):
        rollback(fake, RELEASE, report=report)


@pytest.mark.parametrize("name", ["mine", "rigel.demo.vx", "rigel.other.v1", "rigel.demo.v0"])
def test_a_secret_of_another_name_is_no_revision(fake: Any, report: Any, name: str) -> None:
    """Anyone may give a Secret our label, in any namespace."""
    deploy(desired(workload()), fake, report=report)
    meta = {"name": name, "namespace": RELEASE.namespace, "labels": {revisions.OF: "demo"}}
    fake.create({"apiVersion": "v1", "kind": "Secret", "metadata": meta, "data": {}})
    assert [record.number for record in revisions.records(fake, RELEASE)] == [1]
    assert [one.revision for one in list_releases(fake, None)] == [1]


def test_any_content_is_read_or_refused(fake: Any, report: Any) -> None:
    """Thousands of random changes, or RIGEL_TEST_CASES: no other exception than ours."""
    deploy(desired(workload(), config()), fake, report=report)
    [record] = revisions.records(fake, RELEASE)
    good = json.loads(gzip.decompress(base64.b64decode(record.secret["data"]["release"])))
    chance = random.Random(1)
    for _ in range(int(os.environ.get("RIGEL_TEST_CASES", "5000"))):
        text = content(mutate(good, chance))
        with suppress(RigelK8sError):
            changed = attrs.evolve(record, secret={**record.secret, "data": {"release": text}})
            History().make_entries([changed, attrs.evolve(record, number=2)])
            changed.revision()


ODD = (None, 1, -1.5, "", "x", [], {}, [[]], [None], {"a": 1}, True)


def mutate(value: Any, chance: random.Random) -> Any:
    """Return a value in which one place is another one, or missing."""
    if not value or not isinstance(value, dict | list) or chance.random() < 0.15:
        return chance.choice(ODD)
    if isinstance(value, list):
        place = chance.randrange(len(value))
        return [mutate(one, chance) if i == place else one for i, one in enumerate(value)]
    key = chance.choice(sorted(value))
    if chance.random() < 0.1:
        return {name: one for name, one in value.items() if name != key}
    return {**value, key: mutate(value[key], chance)}
