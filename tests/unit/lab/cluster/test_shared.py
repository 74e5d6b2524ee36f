"""Settings of the machine are changed once and put back once."""

from __future__ import annotations

from pathlib import Path

import pytest

from rigel_lab.cluster import paths, shared

FORWARD = "net/ipv4/ip_forward"
WATCHES = "fs/inotify/max_user_watches"
NEIGHBOURS = "net/ipv4/neigh/default/gc_thresh3"
SETTINGS = {FORWARD: "0", WATCHES: "900000", NEIGHBOURS: "1024", "kernel/panic": "1"}


@pytest.fixture
def sysctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A /proc/sys, a state directory and mount points of the test's own."""
    for key, value in SETTINGS.items():
        (tmp_path / "sys" / key).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "sys" / key).write_text(f"{value}\n")
    monkeypatch.setattr(shared, "PROC_SYS", tmp_path / "sys")
    monkeypatch.setattr(shared, "NETNS", tmp_path / "netns")
    monkeypatch.setattr(shared, "bridges", lambda: ["docker0"])
    monkeypatch.setattr(paths, "STATE", tmp_path / "state")
    monkeypatch.setattr(paths, "LOCKS", tmp_path / "locks")
    return tmp_path / "sys"


def mounts(sysctl: Path) -> list[str]:
    """The mount points of a plain cluster."""
    return [str(sysctl.parent / "opt/cni")]


def silent(_: str) -> None:
    """Take a report."""


def test_settings_are_raised_and_restored(sysctl: Path, tmp_path: Path) -> None:
    """What is too low is raised, what is higher is left; all is as before at the end."""
    shared.acquire("a", mounts(sysctl))
    assert (sysctl / FORWARD).read_text().strip() == "1"
    assert (sysctl / WATCHES).read_text().strip() == "900000"
    (sysctl / "kernel/panic").write_text("10")  # as a kubelet does
    shared.release("a", silent)
    assert (sysctl / FORWARD).read_text().strip() == "0"
    assert (sysctl / "kernel/panic").read_text().strip() == "1"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["sys"]


def test_the_last_cluster_restores(sysctl: Path) -> None:
    """The end of the first of two clusters changes nothing, nor does a second up."""
    for name in ("a", "b", "a"):
        shared.acquire(name, mounts(sysctl))
    shared.release("a", silent)
    assert (sysctl / FORWARD).read_text().strip() == "1"
    shared.release("b", silent)
    assert (sysctl / FORWARD).read_text().strip() == "0"


def test_the_neighbours_of_all_nodes_have_room(sysctl: Path) -> None:
    """The kernel's table of all namespaces is enlarged, and made as small again."""
    shared.acquire("a", mounts(sysctl))
    assert (sysctl / NEIGHBOURS).read_text().strip() == "16384"
    shared.release("a", silent)
    assert (sysctl / NEIGHBOURS).read_text().strip() == "1024"


def test_what_an_older_rigel_did_not_note_is_noted(sysctl: Path) -> None:
    """A setting that this version raises beside an older one's cluster is put back too."""
    shared.acquire("a", mounts(sysctl))
    with shared.changing() as record:
        del record.sysctls[NEIGHBOURS]
    (sysctl / NEIGHBOURS).write_text("512")
    shared.acquire("b", mounts(sysctl))
    assert (sysctl / NEIGHBOURS).read_text().strip() == "16384"
    shared.release("a", silent)
    shared.release("b", silent)
    assert (sysctl / NEIGHBOURS).read_text().strip() == "512"
    assert (sysctl / FORWARD).read_text().strip() == "0"


def test_forwarding_stays_for_who_came_meanwhile(
    sysctl: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bridge that came after us may need forwarding: it stays on, and that is told."""
    shared.acquire("a", mounts(sysctl))
    monkeypatch.setattr(shared, "bridges", lambda: ["docker0", "virbr0"])
    told: list[str] = []
    shared.release("a", told.append)
    assert (sysctl / FORWARD).read_text().strip() == "1"
    assert "virbr0" in told[0]
    assert "docker0" not in told[0]


def test_an_earlier_boot_is_forgotten(sysctl: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a restart of the machine the old values are not written over the new ones."""
    shared.acquire("a", mounts(sysctl))
    monkeypatch.setattr(shared, "boot_id", lambda: "another")
    shared.release("a", silent)
    assert (sysctl / FORWARD).read_text().strip() == "1"


def test_mount_points_of_others_stay(sysctl: Path, tmp_path: Path) -> None:
    """Directories that we made go, unless somebody has put something there."""
    shared.acquire("a", mounts(sysctl))
    (tmp_path / "opt/theirs").mkdir()
    shared.release("a", silent)
    assert not (tmp_path / "opt/cni").exists()
    assert (tmp_path / "opt/theirs").exists()


def test_mount_points_go_with_the_last_who_needs_them(sysctl: Path, tmp_path: Path) -> None:
    """A cluster with more mount points than others takes these along, and only these."""
    more = str(tmp_path / "data")
    shared.acquire("a", [*mounts(sysctl), more])
    shared.acquire("b", mounts(sysctl))
    shared.release("a", silent, mounts(sysctl))
    assert not (tmp_path / "data").exists()
    assert (tmp_path / "opt/cni").exists()
    shared.release("b", silent)
    assert not (tmp_path / "opt").exists()


def test_a_mount_point_of_two_clusters_stays(sysctl: Path, tmp_path: Path) -> None:
    """What another cluster has mounted over is not removed below it."""
    more = str(tmp_path / "data")
    for name in ("a", "b"):
        shared.acquire(name, [more])
    shared.release("a", silent, [more])
    assert (tmp_path / "data").exists()
