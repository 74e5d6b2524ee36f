"""Variables that come from what has changed since a node started."""

from __future__ import annotations

from typing import Any

import attrs
import pytest

from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.release.sources import find_changed

EARLY, START, LATE = (f"2026-01-01T00:0{minute}:00Z" for minute in range(3))
CLOUD = {"name": "cloud", "key": "key"}


@attrs.define
class Objects:
    """A cluster that has them, each with the times of its changes, the first of its creation."""

    times: dict[tuple[str, str], list[str]]
    forbidden: bool = False

    def list(
        self, _: str, kind: str, namespace: str, *, fields: str, metadata_only: bool
    ) -> list[dict[str, Any]]:
        assert (namespace, metadata_only) == ("robot", True), "no value is read"
        if self.forbidden:
            raise Forbidden("no")
        name = fields.removeprefix("metadata.name=")
        times = self.times.get((kind, name), [])
        managed = [{"time": time, "manager": "kubectl"} for time in times]
        meta = {"name": name, "creationTimestamp": min(times, default=""), "managedFields": managed}
        return [{"kind": kind, "metadata": meta}] if times else []

    def parallel(self, function: Any, items: Any) -> list[Any]:
        return [function(item) for item in items]


def find(objects: Objects, **own: Any) -> list[str]:
    """Return what is found of a node with a container of two, which both have started at START."""
    containers = [{"name": "uploader", **own}, {"name": "beside"}]
    meta = {"name": "uploader", "namespace": "robot"}
    live = {"metadata": meta, "spec": {"template": {"spec": {"containers": containers}}}}
    runs = {"running": {"startedAt": START}}
    states = [{"name": "uploader", "state": runs}, {"name": "beside", "state": {}}]
    pod = {"status": {"containerStatuses": states}}
    return find_changed(objects, [live], lambda _: [pod])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "own"),
    [
        ("Secret", {"env": [{"name": "A", "value": "b"}, {"valueFrom": {"secretKeyRef": CLOUD}}]}),
        ("Secret", {"envFrom": [{"secretRef": {"name": "cloud"}}]}),
        ("ConfigMap", {"env": [{"valueFrom": {"configMapKeyRef": CLOUD}}]}),
    ],
)
def test_what_has_changed_since_is_named_with_the_way_out(kind: str, own: Any) -> None:
    [line] = find(Objects({(kind, "cloud"): [EARLY, LATE]}), **own)
    assert line.startswith(f"uploader: {kind} cloud has changed since it started")
    assert line.endswith("`rigel restart uploader`")


@pytest.mark.parametrize(
    "objects",
    [
        Objects({("Secret", "cloud"): [EARLY]}),
        Objects({("Secret", "cloud"): [EARLY, START]}),
        Objects({}),
        Objects({("Secret", "cloud"): [EARLY, LATE]}, forbidden=True),
    ],
)
def test_what_has_not_or_cannot_be_seen_is_not(objects: Objects) -> None:
    """Before the start, at the start, a missing one, without the right to look."""
    assert find(objects, env=[{"valueFrom": {"secretKeyRef": CLOUD}}]) == []


def test_a_container_that_reads_nothing_is_not_compared() -> None:
    assert find(Objects({("Secret", "cloud"): [EARLY, LATE]})) == []
