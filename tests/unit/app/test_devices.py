"""A device that does not exist is an error on its machine; without a type it would be made."""

from __future__ import annotations

import pytest

from .shapes import release

TYPES = {
    "CharDevice": (
        "/dev/nul",
        "/dev/ttyUSB0",
        "/dev/serial/by-id/usb-FTDI_A601-if00-port0",
        "/dev/v4l/by-id/usb-Camera-index0",
        "/dev/bus/usb/001/002",
        "/dev/dri/card0",
        "/dev/net/tun",
        "/dev/mapper/control",
        "/dev/sg0",
        "/dev/nvme0",
        "/dev/mmcblk0rpmb",
        "/dev/loop-control",
        "/robot/arm",
    ),
    "BlockDevice": (
        "/dev/sda",
        "/dev/sdb1",
        "/dev/vda",
        "/dev/nvme0n1p2",
        "/dev/mmcblk0p1",
        "/dev/loop0",
        "/dev/dm-0",
        "/dev/sr0",
        "/dev/disk/by-id/usb-Stick",
        "/dev/mapper/data",
    ),
    "Directory": (
        "/dev",
        "/dev/dri",
        "/dev/snd",
        "/dev/input/by-id",
        "/dev/bus/usb",
        "/dev/bus/usb/001",
        "/dev/shm",
        "/dev/serial",
        "/dev/v4l/by-id",
        "/dev/disk/by-uuid",
        "/dev/mapper",
        "/dev/net",
        "/dev/pts",
        "/dev/robot/",
    ),
}


def host_path(text: str) -> dict[str, str]:
    """Return the hostPath of a node's one device or volume."""
    made = release(f"{{image: a, ros: '2', nodes: {{n: {{args: x, {text}}}}}}}")
    [node] = [one for one in made.objects if one["kind"] == "Deployment"]
    volumes = node["spec"]["template"]["spec"]["volumes"]
    [found] = [one["hostPath"] for one in volumes if "hostPath" in one]
    return dict(found)


@pytest.mark.parametrize(("kind", "path"), [(k, path) for k in TYPES for path in TYPES[k]])
def test_a_device_is_of_the_kind_that_its_path_means(kind: str, path: str) -> None:
    """The kubelet refuses any other, and a directory that the runtime would make."""
    assert host_path(f"devices: [{path}]") == {"path": path, "type": kind}


def test_a_device_elsewhere_in_the_container_has_the_type_of_its_machine() -> None:
    """Where the container sees it does not matter."""
    found = host_path("devices: [{path: /dev/video2, mount_path: /dev/snd}]")
    assert found == {"path": "/dev/video2", "type": "CharDevice"}


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        ("Directory", "/data/maps"),
        ("Directory", "/data/maps.d/"),
        ("Directory", "/dev/shm"),
        ("CharDevice", "/dev/ttyUSB0"),
        ("BlockDevice", "/dev/sda1"),
        ("File", "/data/floor.yaml"),
        ("File", "/etc/machine-id"),
        ("Socket", "/run/docker.sock"),
        (None, "/data/maps.2"),
        (None, "/etc/camera"),
        (None, "/usr/local/bin/tool"),
        (None, "/run/udev"),
    ],
)
def test_a_volume_is_what_its_name_shows(kind: str | None, path: str) -> None:
    """Where that is doubtful, it has no type; what is said in the Rigelfile counts."""
    volume = f"host_path: {path}, mount_path: /a"
    shown = {"type": kind} if kind else {}
    assert host_path(f"volumes: [{{{volume}}}]") == {"path": path, **shown}
    said = {"path": path, "type": "FileOrCreate"}
    assert host_path(f"volumes: [{{{volume}, type: FileOrCreate}}]") == said


def test_a_path_with_colons_is_another_one_in_the_container() -> None:
    """Kubernetes refuses a colon in mountPath only."""
    path = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"
    for device, inside in (
        (path, path.replace(":", "_")),
        (f"{{path: '{path}', mount_path: /dev/lidar}}", "/dev/lidar"),
    ):
        made = release(f"{{image: a, nodes: {{n: {{args: x, devices: [{device}]}}}}}}")
        [node] = [one for one in made.objects if one["metadata"]["name"] == "n"]
        pod = node["spec"]["template"]["spec"]
        assert {"path": path, "type": "CharDevice"} in [v.get("hostPath") for v in pod["volumes"]]
        assert inside in [m["mountPath"] for m in pod["containers"][0]["volumeMounts"]]
