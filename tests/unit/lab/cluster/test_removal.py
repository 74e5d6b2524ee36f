"""The end of a cluster touches nothing that is not its own."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster import cgroups, network, paths, removal, shared
from rigel_lab.cluster.components import Components
from rigel_lab.cluster.machine import RECORD, Process
from rigel_lab.cluster.paths import boot_id
from rigel_lab.cluster.state import State

pytestmark = pytest.mark.programs


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> State:
    """A cluster of one node whose files are there; what is outside of them is not touched."""
    monkeypatch.setattr(paths, "STATE", tmp_path)
    monkeypatch.setattr(paths, "LOCKS", tmp_path / "locks")
    for module, name in ((network, "remove"), (cgroups, "remove"), (shared, "release")):
        monkeypatch.setattr(module, name, lambda *_: None)
    state = State("t", 1, "10.64.0.0/14", boot_id(), "1.34.4", Components({}, "/p"))
    state.save()
    (state.directory / "node1").mkdir()
    return state


def quiet(text: str) -> None:
    """Take a report."""


def test_a_mount_is_not_crossed(cluster: State, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot's disk that is mounted below a node is told, and keeps its files."""
    disk = cluster.directory / "node1" / "disk"
    disk.mkdir()
    (disk / "map").write_text("valuable")
    mounts = cluster.directory.parent / "mountinfo"
    mounts.write_text(
        f"36 35 98:0 / /elsewhere rw - ext4 /dev/a rw\n36 35 98:0 / {disk} rw - x y\n"
    )
    monkeypatch.setattr(removal, "MOUNTS", mounts)
    with pytest.raises(LocalClusterError, match=f"{disk} is still mounted") as caught:
        removal.remove(cluster, quiet)
    assert caught.value.hint == f"umount {disk}"
    assert (disk / "map").read_text() == "valuable"
    assert State.load("t") is not None, "a second try goes on"
    mounts.write_text("")
    removal.remove(cluster, quiet)
    assert not cluster.directory.exists()


def test_links_are_deleted_and_not_what_they_point_to(tmp_path: Path) -> None:
    """Files of all depths go; a link out of the directory goes alone."""
    outside = tmp_path / "outside"
    (outside / "data").mkdir(parents=True)
    inside = tmp_path / "inside"
    for depth in ("a", "a/b", "a/b/c", "d"):
        (inside / depth).mkdir(parents=True, exist_ok=True)
        for number in range(40):
            (inside / depth / f"f{number}").write_text("x")
    (inside / "a" / "to-directory").symlink_to(outside)
    (inside / "to-nothing").symlink_to("nowhere")
    removal.delete(inside)
    assert not inside.exists()
    assert (outside / "data").is_dir()


@pytest.mark.parametrize("same_boot", [True, False])
def test_process_numbers_of_another_boot_are_strangers(cluster: State, same_boot: Any) -> None:
    """After a reboot they belong to somebody else, who may have started at the same tick."""
    if not same_boot:
        cluster.boot = "another"
    with subprocess.Popen(["sleep", "60"]) as running:
        live = Process.of(running.pid)
        assert live is not None
        fields = " ".join(["S", *["0"] * 18, str(live.start)])
        (cluster.directory / "node1" / RECORD).write_text(f"{live.pid} (x) {fields}\n")
        removal.remove(cluster, quiet)
        assert live.alive is not same_boot
        running.kill()
    assert not cluster.directory.exists()
