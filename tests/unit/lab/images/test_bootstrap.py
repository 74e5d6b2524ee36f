"""A root file system that was only unpacked still says of which packages it is."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from rigel_lab.images.base.bootstrap import RECORD

pytestmark = pytest.mark.programs


@pytest.mark.skipif(not shutil.which("dpkg-deb"), reason="needs dpkg-deb")
def test_unpacked_packages_are_recorded(tmp_path: Path) -> None:
    """Each has a file of its own in status.d, which scanners of images read."""
    control = "Package: robot\nVersion: 1.2-3\nArchitecture: all\nMaintainer: A <a@example.org>\n"
    source = tmp_path / "source"
    (source / "DEBIAN").mkdir(parents=True, mode=0o755)
    source.joinpath("DEBIAN/control").write_text(f"{control}Description: none\n")
    root = tmp_path / "root"
    archives = root / "var/cache/apt/archives"
    archives.mkdir(parents=True)
    subprocess.run(
        ["dpkg-deb", "--build", source, archives / "robot_1.2-3_all.deb"],
        check=True,
        capture_output=True,
    )
    subprocess.run(["sh", "-c", RECORD, "exec", root], check=True)
    assert control in (root / "var/lib/dpkg/status.d/robot").read_text()
