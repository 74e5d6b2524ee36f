"""Nodes laid out as k3s does, and what an upgrade of it leaves alone."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from rigel_lab.cluster import k3s
from rigel_lab.cluster.layout import BOUND, k3s_paths, plain_paths


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """CNI programs that say what they are."""
    place = tmp_path / "programs"
    place.mkdir()
    for name in (*k3s.PROGRAMS, "macvlan", "static"):
        (place / name).write_text(f'#!/bin/sh\necho {name} "$@"\n')
        (place / name).chmod(0o755)
    return place


@pytest.fixture
def data(tmp_path: Path, programs: Path) -> Path:
    """A data directory that is the same inside and outside, with a release in it."""
    own = tmp_path / "data-dir"
    k3s.unpack(own, str(own), programs, "1")
    return own


def test_programs_are_absolute_links_into_a_hashed_directory(data: Path) -> None:
    """data/cni has k3s' programs alone; each link leads to the one program of the release."""
    home = data / "data" / k3s.release_name("1")
    links = {path.name: path.readlink() for path in (data / "data/cni").iterdir()}
    assert set(links) == {"cni", *k3s.PROGRAMS}
    assert set(links.values()) == {home / "bin/cni"}
    assert len(home.name) == 64
    assert (data / "data/current").readlink() == home
    assert (home / "bin/portmap").readlink() == Path("cni")


@pytest.mark.programs
def test_the_one_program_does_what_it_is_called(data: Path) -> None:
    """By each of its links it is that program, and gets its arguments."""
    command = [str(data / "data/cni/host-local"), "a b"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == (
        "host-local a b\n"
    )


def test_an_upgrade_replaces_links_and_leaves_files_of_others(data: Path, programs: Path) -> None:
    """Files that are no links stay, k3s' links lead to the new release, the old one stays too."""
    theirs = data / "data/cni/macvlan"
    theirs.write_text("theirs")
    (data / "data/cni/bridge").unlink()
    (data / "data/cni/bridge").write_text("their bridge")
    k3s.unpack(data, str(data), programs, "2")
    old, new = (data / "data" / k3s.release_name(name) for name in ("1", "2"))
    assert theirs.read_text() == "theirs"
    assert (data / "data/cni/bridge").read_text() == "their bridge"
    assert (data / "data/cni/portmap").readlink() == new / "bin/cni"
    assert (data / "data/current").readlink() == new
    assert (data / "data/previous").readlink() == old
    assert old.exists()


def test_links_are_replaced_though_they_lead_nowhere(data: Path, programs: Path) -> None:
    """Also where somebody has removed the old release."""
    shutil.rmtree(data / "data" / k3s.release_name("1"))
    k3s.unpack(data, str(data), programs, "2")
    assert all(path.exists() for path in (data / "data/cni").iterdir())


def test_the_same_release_changes_nothing(data: Path, programs: Path) -> None:
    """A restart of k3s is no upgrade."""
    (data / "data/cni/portmap").unlink()
    k3s.unpack(data, str(data), programs, "1")
    assert not (data / "data/cni/portmap").exists()
    assert not (data / "data/previous").is_symlink()


def test_a_node_tells_its_data_directory() -> None:
    """As k3s does: the argument is split, and left out where it is the default."""
    told = k3s.node_annotations("/data", "1", server=True)
    assert told["k3s.io/node-args"] == '["server","--data-dir","/data"]'
    assert json.loads(told["k3s.io/node-env"]) == {
        "K3S_DATA_DIR": f"/data/data/{k3s.release_name('1')}"
    }
    told = k3s.node_annotations("/var/lib/rancher/k3s", "1", server=False)
    assert told["k3s.io/node-args"] == '["agent"]'


def test_paths_of_both_layouts(tmp_path: Path) -> None:
    """Where a node has CNI, and where the machine has that."""
    plain, ranch = plain_paths(), k3s_paths("/data")
    assert (plain.cni_config, plain.cni_programs) == ("/etc/cni/net.d", "/opt/cni/bin")
    assert plain.locate(tmp_path, plain.cni_config) == tmp_path / "etc-cni/net.d"
    assert ranch.cni_config == "/data/agent/etc/cni/net.d"
    assert ranch.locate(tmp_path, ranch.cni_programs) == tmp_path / "k3s/data/cni"
    assert set(BOUND) <= set(ranch.binds)
    with pytest.raises(ValueError, match="/usr/bin"):
        ranch.locate(tmp_path, "/usr/bin")
