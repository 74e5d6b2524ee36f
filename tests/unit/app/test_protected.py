"""What `down` leaves unless volumes are asked for."""

from __future__ import annotations

from rigel_k8s.app.desired import list_protected


def test_data_outlive_down() -> None:
    """Claims and the volumes that they are bound to; nothing else stays."""
    kinds = ("Deployment", "PersistentVolumeClaim", "Service", "PersistentVolume", "ConfigMap")
    made = [
        {"apiVersion": "v1", "kind": kind, "metadata": {"name": "maps", "namespace": "robot"}}
        for kind in kinds
    ]
    found = [ref.kind for ref in list_protected(made)]
    assert found == ["PersistentVolumeClaim", "PersistentVolume"]
