"""Persistent volumes: claims, and static volumes on a directory of a machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rigel_k8s.objects.naming import labels
from rigel_k8s.objects.podoptions import Volume
from rigel_k8s.objects.pods import Object, drop_empty


def claim_name(name: str) -> str:
    """Return the name of a volume's claim."""
    return f"{name}-pvc"


def volume_name(name: str) -> str:
    """Return the name of a static volume."""
    return f"{name}-pv"


def mount_path(volume: Volume) -> str:
    """Return where a volume is mounted by default."""
    return str(volume.mount_path or f"/persistent/{volume.name}")


def volume_source(volume: Volume) -> Object:
    """Return a pod's volume."""
    return {
        "name": str(volume.name),
        "persistentVolumeClaim": {"claimName": claim_name(volume.name)},
    }


def storage(
    volumes: Sequence[Volume], namespace: str, release: str
) -> Iterator[tuple[int, Object]]:
    """Yield the objects of all volumes, each with its volume's index."""
    for index, volume in enumerate(volumes):
        if volume.host_path:
            yield index, static_volume(volume, release)
        yield index, claim(volume, namespace, release)


def storage_class(volume: Volume) -> str | None:
    """Return the class: "" for a static volume, or its claim would get the default one."""
    if volume.storage_class is not None:
        return volume.storage_class
    return "" if volume.host_path else None


def claim(volume: Volume, namespace: str, release: str) -> Object:
    """Return a volume's claim."""
    spec = {
        "accessModes": [volume.access_mode],
        "resources": {"requests": {"storage": str(volume.size)}},
        "volumeName": volume_name(volume.name) if volume.host_path else None,
        "storageClassName": storage_class(volume),
    }
    return {
        "apiVersion": "v1",
        "kind": "PersistentVolumeClaim",
        "metadata": {
            "name": claim_name(volume.name),
            "namespace": namespace,
            "labels": labels(volume.name, release),
        },
        "spec": drop_empty(spec),
    }


def static_volume(volume: Volume, release: str) -> Object:
    """Return the cluster-wide volume on a machine's directory; its data is never deleted."""
    spec = {
        "capacity": {"storage": str(volume.size)},
        "accessModes": [volume.access_mode],
        "hostPath": {"path": str(volume.host_path), "type": "DirectoryOrCreate"},
        "persistentVolumeReclaimPolicy": "Retain",
        "storageClassName": storage_class(volume),
    }
    return {
        "apiVersion": "v1",
        "kind": "PersistentVolume",
        "metadata": {"name": volume_name(volume.name), "labels": labels(volume.name, release)},
        "spec": drop_empty(spec),
    }
