"""A revision fits into its Secret, or nothing is written."""

from __future__ import annotations

import base64
import cProfile
import hashlib
import pstats
from typing import Any

import pytest

from rigel_k8s.errors import UserError
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release import revisions
from rigel_k8s.release.rollout.view import find_related
from rigel_k8s.release.status import describe_workload
from rigel_k8s.release.types import InventoryItem, Revision
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy

REVISION = "deployment.kubernetes.io/revision"


def noise(seed: str, size: int) -> str:
    """Return a text that can hardly be compressed, always the same."""
    parts = (hashlib.sha256(f"{seed}/{n}".encode()).hexdigest() for n in range(size // 64 + 1))
    return "".join(parts)[:size]


def size_of(live: Any) -> int:
    """Return what Kubernetes counts of a Secret."""
    return sum(len(base64.b64decode(value)) for value in live["data"].values())


def test_a_thousand_different_nodes_take_a_third_of_a_secret() -> None:
    """Each node has its own name, image, arguments and variables, and its UID."""
    objects = []
    for number in range(1000):
        made = workload(f"node-{number:04}", image=f"robots/driver-{number}:1.{number}")
        pod = made["spec"]["template"]["spec"]["containers"][0]
        pod["args"] = [f"--serial={noise(f'serial {number}', 32)}"]
        pod["env"] = [{"name": f"CAMERA_{n}", "value": f"/dev/video{number * n}"} for n in range(8)]
        objects.append(made)
    inventory = tuple(InventoryItem(one, revisions.fake_uid(one)) for one in map(ref_of, objects))
    options = {"nodes": {made["metadata"]["name"]: {"args": ["x"]} for made in objects}}
    revision = Revision(RELEASE, 1, "good", "", tuple(objects), inventory, options)
    assert size_of(revisions.encode(revision)) < revisions.MAX_SIZE // 3


def test_what_does_not_fit_is_refused_before_anything_is_written(
    fake: FakeCluster, report: Recorder
) -> None:
    """No Lease, no namespace, no object: the error says how large it is and what to do."""
    large = [config(f"c{n}", map=noise(str(n), 400_000)) for n in range(6)]
    with pytest.raises(UserError, match=r"would take 1\d{3} KiB, .* holds 1024 KiB") as caught:
        deploy(desired(*large), fake, report=report)
    assert "several jobs" in str(caught.value.hint)
    assert {verb for verb, _ in fake.calls} <= {"get", "list", "try", "review"}


def test_uids_that_are_not_there_yet_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """A revision must still fit when it is marked good: each object has its UID by then."""
    objects = tuple(config(f"c{n}") for n in range(200))
    inventory = tuple(InventoryItem(ref_of(one)) for one in objects)
    pending = Revision(RELEASE, 1, "pending", "", objects, inventory)
    monkeypatch.setattr(revisions, "MAX_SIZE", size_of(revisions.encode(pending)) + 100)
    with pytest.raises(UserError):
        revisions.check_size(pending)


def crowd(count: int) -> dict[str, list[dict[str, Any]]]:
    """Return Deployments that are not ready, each with a ReplicaSet, a pod and a warning."""
    found: dict[str, list[dict[str, Any]]] = {
        "Deployment": [],
        "ReplicaSet": [],
        "Pod": [],
        "Event": [],
    }
    for number in range(count):
        made = workload(f"n{number}")
        above = ""
        for kind, live in (("Deployment", made), ("ReplicaSet", made), ("Pod", {"spec": {}})):
            uid = f"{kind}-{number}"
            meta = {"name": uid.lower(), "uid": uid, "annotations": {REVISION: "1"}}
            if above:
                meta["ownerReferences"] = [{"controller": True, "uid": above}]
            found[kind].append({**live, "kind": kind, "metadata": meta})
            above = uid
        about = {"involvedObject": {"uid": above}, "reason": "FailedMount", "message": "no volume"}
        found["Event"].append(about)
    return found


def count_calls(count: int) -> int:
    """Return how many functions a status calls for so many workloads: the same on any machine."""
    found = crowd(count)
    profile = cProfile.Profile()
    profile.enable()
    related = find_related(found["ReplicaSet"], found["Pod"], found["Event"])
    told = [describe_workload(live, related) for live in found["Deployment"]]
    profile.disable()
    assert all("FailedMount: no volume" in one.message for one in told)
    return int(vars(pstats.Stats(profile))["total_calls"])


def test_a_status_costs_the_same_for_a_node_among_few_and_among_many() -> None:
    few, more, many = map(count_calls, (20, 120, 220))
    assert many - more == pytest.approx(more - few, rel=0.02)
