"""What podman is given; its real runs are in tests/cluster/test_images_podman.py."""

from __future__ import annotations

from pathlib import Path

import pytest

from rigel_k8s.images.engine import Build
from rigel_k8s.images.podman import Podman, lacks_sys_resource, registries_conf, registries_of
from rigel_k8s.oci import host_platform

FULL = "Uid:\t0\t0\t0\t0\nCapEff:\t000001ffffffffff\n"
LACKING = "Uid:\t0\t0\t0\t0\nCapEff:\t000001fffeffffff\n"
ROOTLESS = "Uid:\t1000\t1000\t1000\t1000\nCapEff:\t0000000000000000\n"


@pytest.mark.parametrize(("status", "lacks"), [(FULL, False), (LACKING, True), (ROOTLESS, False)])
def test_only_a_root_without_the_capability_needs_another_isolation(
    status: str, *, lacks: bool
) -> None:
    """A full root and podman without root keep podman's own isolation."""
    assert lacks_sys_resource(status) is lacks


def test_another_isolation_is_told() -> None:
    """Who builds with chroot isolation is told so, and why."""
    assert Podman("podman").notes == ()
    (note,) = Podman("podman", isolation="chroot").notes
    assert "BUILDAH_ISOLATION=chroot" in note
    assert "CAP_SYS_RESOURCE" in note


def test_platforms_are_those_with_an_emulator(tmp_path: Path) -> None:
    """This machine's platform comes first; others need an emulator that the kernel knows."""
    assert Podman("podman", binfmt=tmp_path).platforms() == (host_platform(),)
    (tmp_path / "qemu-aarch64").touch()
    (tmp_path / "qemu-x86_64").touch()
    assert set(Podman("podman", binfmt=tmp_path).platforms()) == {"linux/amd64", "linux/arm64"}
    assert Podman("podman", binfmt=tmp_path).platforms()[0] == host_platform()


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", 'unqualified-search-registries = ["docker.io"]\n'),
        ("[registries.search]\n", 'unqualified-search-registries = ["docker.io"]\n'),
        ("# a\nunqualified-search-registries = []\n", "# a\nunqualified-search-registries = []\n"),
    ],
)
def test_short_names_mean_docker_hub_unless_the_user_said_otherwise(
    before: str, after: str
) -> None:
    """`FROM ros:noetic` works on a fresh podman; a choice of the user's stays."""
    assert registries_conf(before, []) == after


def test_insecure_registries_are_named_one_by_one() -> None:
    """Plain HTTP is for the named registries alone."""
    conf = registries_conf("", ["b:1", "a:1"])
    assert conf.count("insecure = true") == 2
    assert conf.index('location = "a:1"') < conf.index('location = "b:1"')


def test_the_registries_of_a_build_are_found(tmp_path: Path) -> None:
    """Those of its names, of FROM lines and of build arguments that are images."""
    file = tmp_path / "Dockerfile"
    file.write_text("ARG B\nFROM $B AS x\nfrom --platform=linux/arm64 c:3/base\nFROM x\n")
    build = Build(("a:1/app:1",), tmp_path, file, {"B": "b:2/ros", "VERSION": "1.2 beta"})
    assert registries_of(build) == {"a:1", "b:2", "c:3", "docker.io"}
