"""An update by Recreate pulls an image that the machine does not have while the old pod runs."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rigel_k8s.objects.marks import PULL_LABEL
from tests.support.larger import push_larger
from tests.support.releases import deploy

from ..conftest import pod_uids

pytestmark = pytest.mark.cluster


def test_the_image_is_there_before_the_old_pod_ends(
    admin: Any, cluster: Any, make: Any, report: Any
) -> None:
    """By the order of what happens to pods; the new pod has nothing to pull."""
    machine = admin.nodes()[0]["metadata"]["labels"]["kubernetes.io/hostname"]
    pinned = {"nodeSelector": {"kubernetes.io/hostname": machine}}
    deploy(make.desired(make.deployment(pod=pinned)), cluster, report=report)
    (old,) = pod_uids(cluster, make.namespace).values()
    image = push_larger(make.image, 64)
    seen: list[str] = []
    over, listed = threading.Event(), threading.Event()

    def follow() -> None:
        watch = admin.watch(
            "v1", "Pod", make.namespace, seconds=120, cancel=over, listed=listed.set
        )
        for event in watch:
            seen.extend(describe(event, old))

    thread = threading.Thread(target=follow)
    thread.start()
    try:
        assert listed.wait(30)
        deploy(make.desired(make.deployment(image=image, pod=pinned)), cluster, report=report)
    finally:
        over.set()
        thread.join()
    assert list(dict.fromkeys(seen)) == ["pull ends", "old pod ends"]
    node = admin.nodes()[0]["metadata"]["name"]
    assert [state for state in report.states if state[0] == node] == [
        (node, f"pulls {image} before the update", False),
        (node, f"has pulled {image}", True),
    ]
    (new,) = pod_uids(cluster, make.namespace).values()
    events = admin.events({"metadata": {"uid": new, "namespace": make.namespace}})
    (message,) = (event["message"] for event in events if event["reason"] == "Pulled")
    assert "already present" in message


def describe(event: Any, old: str) -> list[str]:
    """Return what has happened to the old pod, or to one that pulls."""
    meta = event.object["metadata"]
    if meta["uid"] == old:
        return ["old pod ends"] if meta.get("deletionTimestamp") else []
    return ["pull ends"] if PULL_LABEL in meta["labels"] and event.type == "DELETED" else []
