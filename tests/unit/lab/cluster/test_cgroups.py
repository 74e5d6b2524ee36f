"""Cgroups of a hierarchy of either version are made and removed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster import cgroups


def unified() -> Path | None:
    """Return where the version 2 hierarchy is, None where we cannot write to one."""
    for line in Path("/proc/self/mounts").read_text().splitlines():
        _, point, kind, options, *_ = line.split()
        if kind == "cgroup2" and "rw" in options.split(",") and os.geteuid() == 0:
            return Path(point)
    return None


@pytest.mark.skipif(unified() is None, reason="needs root and a writable cgroup v2 hierarchy")
def test_version_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """One cgroup for all controllers; it goes with all that containers made below it."""
    root = unified()
    assert root is not None
    monkeypatch.setattr(cgroups, "ROOT", root)
    cluster = f"unit-{os.getpid()}"
    try:
        assert cgroups.create(cluster, "node1") == f"/rigel-{cluster}/node1"
        (root / f"rigel-{cluster}/node1/kubepods").mkdir()
    finally:
        cgroups.remove(cluster)
    assert not (root / f"rigel-{cluster}").exists()


def test_version_one_needs_cpus_and_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cpuset is given its parent's processors and memory, without which nothing runs in it."""
    monkeypatch.setattr(cgroups, "ROOT", tmp_path)
    cpuset = tmp_path / "cpuset"
    cpuset.mkdir()
    for key, value in (("cpuset.cpus", "0-1"), ("cpuset.mems", "0")):
        (cpuset / key).write_text(value)
    (tmp_path / "unified").mkdir()
    cgroups.create("a", "node1")
    assert (cpuset / "rigel-a/node1/cpuset.cpus").read_text() == "0-1"
    assert (cpuset / "rigel-a/node1/cpuset.mems").read_text() == "0"
    assert not list((tmp_path / "unified").iterdir())


def test_read_only_cgroups_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An unprivileged container is named as the likely cause."""
    monkeypatch.setattr(cgroups, "ROOT", tmp_path)
    (tmp_path / "memory").mkdir()
    (tmp_path / "memory/rigel-a").touch()
    with pytest.raises(LocalClusterError, match="cannot make the cgroup") as caught:
        cgroups.create("a", "node1")
    assert "privileged" in (caught.value.hint or "")
