"""What `down` leaves unless volumes are asked for."""

from __future__ import annotations

from rigel_k8s.app.desired import Draft
from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.release.types import ReleaseId


def test_data_outlive_down() -> None:
    """Claims and the volumes that they are bound to; nothing else stays."""
    kinds = ("Deployment", "PersistentVolumeClaim", "Service", "PersistentVolume", "ConfigMap")
    made = [
        {"apiVersion": "v1", "kind": kind, "metadata": {"name": "maps", "namespace": "robot"}}
        for kind in kinds
    ]
    drafted = Draft(ReleaseId("robot", "robot"), GENERATIONS["2"], [((), one) for one in made])
    kept = {ref.kind for ref in drafted.finish().protected}
    assert kept == {"PersistentVolumeClaim", "PersistentVolume"}
