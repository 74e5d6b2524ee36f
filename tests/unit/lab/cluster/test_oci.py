"""Images without a container engine."""

from __future__ import annotations

import io
import os
import tarfile
from pathlib import Path

from rigel_lab.cluster.oci import Image


def image(program: Path) -> Image:
    return Image("a/b:1", {"bin/x": program, "etc/y": "text"}, ["/bin/x"], links={"bin/sh": "x"})


def test_the_same_files_give_the_same_bytes(tmp_path: Path) -> None:
    """Neither the time nor a file's date or owner changes an image's digest."""
    program = tmp_path / "x"
    program.write_bytes(b"\x7fELF")
    first = image(program).layer()
    os.utime(program, (1, 1))
    program.chmod(0o700)
    assert image(program).layer() == first


def test_a_layer_holds_directories_files_and_links(tmp_path: Path) -> None:
    """Every parent is there before its files, programs are executable, /tmp is everybody's."""
    program = tmp_path / "x"
    program.write_bytes(b"\x7fELF")
    with tarfile.open(fileobj=io.BytesIO(image(program).layer())) as tar:
        members = {member.name: member for member in tar}
    assert list(members) == ["bin", "etc", "tmp", "bin/x", "etc/y", "bin/sh"]
    assert members["bin/x"].mode == 0o755
    assert members["etc/y"].mode == 0o644
    assert members["tmp"].mode == 0o1777
    assert members["bin/sh"].linkname == "x"
