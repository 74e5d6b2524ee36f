"""Volumes and devices: what a node sees of them, and the objects of persistent ones.

A persistent volume is a claim, and a static volume too if it is on a directory of a machine.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.objects.naming import labels
from rigel_k8s.objects.podoptions import Device, Volume, VolumeMount
from rigel_k8s.objects.pods import Object, drop_empty
from rigel_k8s.objects.scalars import DevicePath, ObjectName

#: Folders that a device may be, so that the container sees all that they contain.
FOLDERS = re.compile(
    r"/dev(/(bus(/usb(/\d{3})?)?|(dri|snd|input|serial|v4l|disk)(/by-\w+)?|dma_heap|hugepages"
    r"|infiniband|mapper|net|pts|shm|vfio))?|.*/"
)
BLOCK_DEVICES = re.compile(
    r"/dev/([shv]d[a-z]+\d*|xvd[a-z]+\d*|nvme\d+n\d+(p\d+)?|mmcblk\d+((p|boot)\d+)?|(loop|nbd|md)\d+"
    r"(p\d+)?|(dm-|sr|ram|zram)\d+|disk/by-\w+/.+|mapper/(?!control$).+)"
)
#: What the name of a path outside of /dev shows; a name without a dot may be a file in some places.
NAMES = {
    "Socket": re.compile(r".*\.sock"),
    "File": re.compile(
        r"/etc/(group|host(name|s)|localtime|machine-id|passwd|timezone)"
        r"|.*\.(bag|cfg|conf|crt|csv|db3|engine|env|ini|jpe?g|json|key|launch|mcap|onnx|pb|pbstream"
        r"|pcd|pem|pgm|ply|png|pth?|py|rviz|sdf|sh|so|stl|tflite|toml|txt|urdf|xacro|xml|ya?ml)"
    ),
    "Directory": re.compile(r".*/|(?!/(etc|proc|run|sys|var/run|(usr/(local/)?)?s?bin)/).*/[^./]+"),
}


def mount_of(item: ObjectName | VolumeMount) -> VolumeMount:
    """Return a mount, written as a volume's name or in full."""
    return item if isinstance(item, VolumeMount) else VolumeMount(name=item)


def find_mounts(wanted: Sequence[ObjectName | VolumeMount], path: str) -> Iterator[int]:
    """Yield which of a node's `volumes` are mounted at a path."""
    for index, mount in enumerate(map(mount_of, wanted)):
        if str(mount.mount_path).rstrip("/") == path:
            yield index


def device_of(item: DevicePath | Device) -> Device:
    """Return a device, written as a path or in full."""
    return item if isinstance(item, Device) else Device(path=item)


def device_type(path: str) -> str:
    """Return the type of a device's hostPath: without one, a missing device becomes a directory."""
    if FOLDERS.fullmatch(path):
        return "Directory"
    return "BlockDevice" if BLOCK_DEVICES.fullmatch(path) else "CharDevice"


def volume_type(path: str) -> str | None:
    """Return the type of a volume's hostPath as far as its name shows it; None if it does not.

    A file that is missing without a type becomes a directory, and a directory an empty one.
    """
    if path.startswith("/dev/"):
        return device_type(path)
    return next((kind for kind, names in NAMES.items() if names.fullmatch(path)), None)


def source_count(mount: VolumeMount) -> int:
    """Return how many sources a mount names; it should be one."""
    sources = (mount.name, mount.host_path, mount.config_map, mount.secret, mount.memory)
    return sum(source is not None for source in sources)


def mounts(
    wanted: Sequence[ObjectName | VolumeMount],
    devices: Sequence[DevicePath | Device],
    known: Mapping[str, Volume],
    prefix: str = "",
) -> tuple[list[Object], list[Object]]:
    """Return (the pod's volumes, the container's mounts); a claim gives one volume.

    Args:
        prefix: of the names of volumes that are the node's own, in a pod with other nodes.
    """
    volumes: dict[str, Object] = {}
    seen = []
    for index, item in enumerate(wanted):
        mount = mount_of(item)
        source = volume_of(mount, f"{prefix}volume-{index}")
        volumes[source["name"]] = source
        seen.append(mount_entry(mount, source["name"], known))
    for index, device in enumerate(map(device_of, devices)):
        if device.path:
            name = f"{prefix}device-{index}"
            path = str(device.path)
            volumes[name] = {"name": name, "hostPath": {"path": path, "type": device_type(path)}}
            seen.append({"name": name, "mountPath": str(device.mount_path or device.path.inside)})
    return list(volumes.values()), seen


def volume_of(mount: VolumeMount, name: str) -> Object:
    """Return the pod's volume of a mount, with this name unless it is a claim."""
    if mount.name:
        claim = {"claimName": f"{mount.name}-pvc"}
        return {"name": str(mount.name), "persistentVolumeClaim": claim}
    host = str(mount.host_path or "")
    kind = mount.type or volume_type(host)
    source: dict[str, Any] = {
        "hostPath": drop_empty({"path": host, "type": kind}) if host else None,
        "configMap": {"name": str(mount.config_map)} if mount.config_map else None,
        "secret": {"secretName": str(mount.secret)} if mount.secret else None,
        "emptyDir": {"medium": "Memory", "sizeLimit": str(mount.memory)} if mount.memory else None,
    }
    return {"name": name, **drop_empty(source)}


def mount_entry(mount: VolumeMount, name: str, known: Mapping[str, Volume]) -> Object:
    """Return the container's mount."""
    default = mount_path(known[mount.name]) if mount.name else None
    return drop_empty(
        {
            "name": name,
            "mountPath": str(mount.mount_path or default),
            "subPath": mount.sub_path,
            "readOnly": mount.read_only or None,
        }
    )


def device_resources(devices: Sequence[DevicePath | Device]) -> dict[str, str]:
    """Return the limits that request devices from device plugins."""
    asked = map(device_of, devices)
    return {str(d.resource): str(int(d.count)) for d in asked if d.resource}


def mount_path(volume: Volume) -> str:
    """Return where a volume is mounted by default."""
    return str(volume.mount_path or f"/persistent/{volume.name}")


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
    spec = {
        "accessModes": [volume.access_mode],
        "resources": {"requests": {"storage": str(volume.size)}},
        "volumeName": f"{volume.name}-pv" if volume.host_path else None,
        "storageClassName": storage_class(volume),
    }
    return {
        "apiVersion": "v1",
        "kind": "PersistentVolumeClaim",
        "metadata": {
            "name": f"{volume.name}-pvc",
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
        "metadata": {"name": f"{volume.name}-pv", "labels": labels(volume.name, release)},
        "spec": drop_empty(spec),
    }
