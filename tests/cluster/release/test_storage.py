"""No data is lost: claims outlive a `down`."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
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
