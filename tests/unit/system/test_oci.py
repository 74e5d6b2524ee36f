"""Images made without a container engine: what is in them, and that their bytes never change."""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from pathlib import Path

import pytest

from rigel_k8s.system import oci
from rigel_k8s.system.oci import Entry

ENTRIES = [Entry("a/b", b"text"), Entry("a/c", link="b"), Entry("bin/x", b"prog", mode=0o755)]


@pytest.fixture(autouse=True)
def amd64(monkeypatch: pytest.MonkeyPatch) -> None:
    """The digests below are those of an amd64 machine."""
    monkeypatch.setattr("platform.machine", lambda: "x86_64")


def members(layer: bytes) -> dict[str, tarfile.TarInfo]:
    with tarfile.open(fileobj=io.BytesIO(layer)) as tar:
        return {member.name: member for member in tar}


@pytest.fixture
def layers(tmp_path: Path) -> list[Path]:
    """Two layers as files."""
    files = [tmp_path / "two.tar", tmp_path / "one.tar"]
    files[0].write_bytes(b"x" * 10240)
    files[1].write_bytes(oci.layer(ENTRIES, mtime=1704067200))
    return files


def test_a_layer_holds_files_links_and_directories() -> None:
    """Each with the permissions that its kind usually has, unless it says others."""
    more = [Entry("d", directory=True, owner=7), Entry("e", link="d", mode=0o600)]
    found = members(oci.layer([*ENTRIES, *more], mtime=5))
    assert [(m.name, m.mode, m.uid, m.gid, m.mtime) for m in found.values()] == [
        ("a/b", 0o644, 0, 0, 5),
        ("a/c", 0o777, 0, 0, 5),
        ("bin/x", 0o755, 0, 0, 5),
        ("d", 0o755, 7, 7, 5),
        ("e", 0o600, 0, 0, 5),
    ]
    assert (found["a/c"].linkname, found["a/b"].size) == ("b", 4)
    assert found["d"].isdir()


def test_the_same_input_gives_the_same_digests(tmp_path: Path, layers: list[Path]) -> None:
    """These are the digests of the first release: another one would restart robots."""
    assert hashlib.sha256(layers[1].read_bytes()).hexdigest() == (
        "94c1f4d962bf027f3bbfe5921d0a68d77bd2ad8f1d3c7d569ef424f1678d5908"
    )
    file, config = tmp_path / "t.tar", {"Entrypoint": ["/x"], "Cmd": ["bash"]}
    found = oci.write_archive(file, layers, config, "localhost/a/b:1", created=1704067200)
    assert found == "sha256:57055f2302d95d9a51bd41ab602e1b58ca8b2c0b58b31d4afcb14dd4dce8d16b"
    assert hashlib.sha256(file.read_bytes()).hexdigest() == (
        "e5cb57788f77f02c3ebd03bee0f4dda4574d0928cb798576c352042744331914"
    )
    assert not list(tmp_path.glob("*.partial"))


def test_an_archive_appears_only_when_it_is_complete(
    tmp_path: Path, layers: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half an archive in the cache would be taken for a whole one."""

    def fail(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(oci, "_indexes", fail)
    with pytest.raises(OSError, match="no space"):
        oci.write_archive(tmp_path / "t.tar", layers, {}, "a:1", created=0)
    assert not (tmp_path / "t.tar").exists()


def test_an_archive_has_both_formats_and_true_digests(tmp_path: Path, layers: list[Path]) -> None:
    """It is a docker archive and an OCI layout; both name the same parts."""
    found = oci.write_archive(tmp_path / "a.tar", layers, {"Cmd": ["x"]}, "h/i:t", created=0)
    with tarfile.open(tmp_path / "a.tar") as tar:
        content = {m.name: tar.extractfile(m).read() for m in tar.getmembers()}  # type: ignore[union-attr]
    for name, blob in content.items():
        if name.startswith("blobs/"):
            assert name == f"blobs/sha256/{hashlib.sha256(blob).hexdigest()}"
    docker = json.loads(content["manifest.json"])[0]
    assert docker["RepoTags"] == ["h/i:t"]
    assert docker["Config"] == f"blobs/{found.replace(':', '/')}"
    image = json.loads(content[docker["Config"]])
    assert image["config"] == {"Cmd": ["x"]}
    assert len(image["history"]) == len(image["rootfs"]["diff_ids"]) == 2
    assert image["created"] == "1970-01-01T00:00:00Z"
    index = json.loads(content["index.json"])["manifests"][0]
    manifest = json.loads(content[f"blobs/{index['digest'].replace(':', '/')}"])
    listed = [f"blobs/{layer['digest'].replace(':', '/')}" for layer in manifest["layers"]]
    assert listed == docker["Layers"]
    assert [content[name] for name in listed] == [file.read_bytes() for file in layers]
    assert index["annotations"]["io.containerd.image.name"] == "h/i:t"


def test_what_is_written_is_read(tmp_path: Path, layers: list[Path]) -> None:
    """The parts of an archive are those that it was made of, in their order."""
    file = tmp_path / "a.tar"
    found = oci.write_archive(file, layers, {"Cmd": ["x"]}, "h/i:t", created=0)
    with tarfile.open(file) as tar:
        image = oci.read_archive(tar)
        assert image.config.digest == found
        assert [layer.read() for layer in image.layers] == [path.read_bytes() for path in layers]
        for part in (image.manifest, image.config, *image.layers):
            content = part.read()
            assert (part.digest, part.size) == (oci.digest(content), len(content))


@pytest.mark.parametrize(
    ("machine", "platform", "architecture"),
    [
        ("x86_64", "linux/amd64", "amd64"),
        ("AMD64", "linux/amd64", "amd64"),
        ("aarch64", "linux/arm64", "arm64"),
        ("armv7l", "linux/arm/v7", "arm"),
        ("riscv64", "linux/riscv64", "riscv64"),
    ],
)
def test_a_machine_is_named_as_images_name_it(
    machine: str, platform: str, architecture: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One table for all: what is built here runs here."""
    monkeypatch.setattr("platform.machine", lambda: machine)
    assert (oci.host_platform(), oci.architecture()) == (platform, architecture)
