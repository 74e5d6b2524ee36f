"""The ROS 1 base image without building it: the overlay, the archive's format, and the cache."""

from __future__ import annotations

import hashlib
import io
import json
import os
import stat
import subprocess
import tarfile
from pathlib import Path

import pytest

from rigel_k8s.errors import CommandFailed, RigelK8sError
from rigel_k8s.images.base import archive
from rigel_k8s.images.ros1base import REFERENCES, BaseImage, build, load, overlay, push
from rigel_k8s.images.ros1base.packages import PACKAGES
from tests.support.recorder import Recorder

MMDEBSTRAP = """#!/bin/sh
echo "I: downloading packages with apt..." >&2
for target; do :; done
[ -n "$FAIL" ] && { echo "E: no such mirror" >&2; exit 25; }
printf '%s\\n' "$*" >"$LOG"
mkdir -p "$target.d/usr/share"; tar -C "$target.d" -cf "$target" .
"""
ENGINE = """#!/bin/sh
printf '%s %s\\n' "$(basename "$0")" "$*" >>"$LOG"
[ -z "$FAIL" ] || { echo "no space left" >&2; exit 125; }
"""


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH of programs that note how they were called; returns the note."""
    folder, log = tmp_path / "bin", tmp_path / "log"
    folder.mkdir()
    for name, text in (("mmdebstrap", MMDEBSTRAP), ("podman", ENGINE), ("docker", ENGINE)):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    monkeypatch.setenv("LOG", str(log))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("FAIL", raising=False)
    return log


def files(layer: bytes) -> dict[str, tarfile.TarInfo]:
    with tarfile.open(fileobj=io.BytesIO(layer)) as tar:
        return {member.name: member for member in tar.getmembers()}


def test_official_paths():
    """What Dockerfiles and Rigelfiles name of the official image is there."""
    found = files(overlay.layer("core", mtime=0))
    assert found["ros_entrypoint.sh"].mode == 0o755
    assert found["opt/ros/noetic/bin/roscore"].linkname == "/usr/bin/roscore"
    assert {f"opt/ros/noetic/setup.{shell}" for shell in ("sh", "bash", "zsh")} <= set(found)
    assert overlay.CONFIG["Entrypoint"] == ["/ros_entrypoint.sh"]
    assert "ROS_DISTRO=noetic" in overlay.CONFIG["Env"]


def test_descriptions():
    """Packages whose package.xml Debian ships with the headers get one, unless the headers come."""
    description = "usr/share/std_msgs/package.xml"
    assert description in files(overlay.layer("core", mtime=0))
    assert description not in files(overlay.layer("devel", mtime=0))
    assert "libstd-msgs-dev" in PACKAGES["devel"]


@pytest.mark.parametrize("shell", ["sh", "bash"])
@pytest.mark.parametrize("before", ["", "/opt/ros/noetic:/elsewhere"])
def test_setup(shell: str, before: str):
    """Sourced once or twice, in sh or bash, with -eu: the same environment."""
    setup = Path(overlay.__file__).parent / "files" / "setup.sh"
    script = f'set -eu; . {setup}; . {setup}; echo "$PATH $ROS_PACKAGE_PATH $CMAKE_PREFIX_PATH"'
    env = {"PATH": "/usr/bin:/bin", **({"CMAKE_PREFIX_PATH": before} if before else {})}
    done = subprocess.run([shell, "-c", script], capture_output=True, text=True, env=env)
    expected = "/opt/ros/noetic/bin:/usr/bin:/bin /opt/ros/noetic/share /opt/ros/noetic\n"
    assert (done.stdout, done.stderr) == (expected, "")


def test_same_bytes(tmp_path: Path):
    """The same layers give the same archive, so an unchanged image is not pushed again."""
    layer = tmp_path / "layer.tar"
    layer.write_bytes(overlay.layer("core", mtime=7))
    assert overlay.layer("core", mtime=7) == layer.read_bytes()
    ids = [archive.write(tmp_path / n, [layer], {}, "a/b:1", created=7) for n in ("1", "2")]
    assert ids[0] == ids[1]
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()


def test_both_formats(tmp_path: Path):
    """The archive is a docker archive and an OCI layout whose digests are true."""
    layer = tmp_path / "layer.tar"
    layer.write_bytes(overlay.layer("core", mtime=0))
    found = archive.write(tmp_path / "a.tar", [layer, layer], {"Cmd": ["x"]}, "h/i:t", created=0)
    with tarfile.open(tmp_path / "a.tar") as tar:
        content = {m.name: tar.extractfile(m).read() for m in tar.getmembers()}  # type: ignore
    for name, blob in content.items():
        if name.startswith("blobs/"):
            assert name == f"blobs/sha256/{hashlib.sha256(blob).hexdigest()}"
    docker = json.loads(content["manifest.json"])[0]
    assert docker["RepoTags"] == ["h/i:t"]
    assert docker["Config"] == f"blobs/sha256/{found}"
    image = json.loads(content[docker["Config"]])
    assert image["config"] == {"Cmd": ["x"]}
    assert len(image["history"]) == len(image["rootfs"]["diff_ids"]) == 2
    index = json.loads(content["index.json"])["manifests"][0]
    manifest = json.loads(content[f"blobs/sha256/{index['digest'].removeprefix('sha256:')}"])
    assert [f"blobs/{e['digest'].replace(':', '/')}" for e in manifest["layers"]] == docker[
        "Layers"
    ]
    assert index["annotations"]["io.containerd.image.name"] == "h/i:t"


def test_cache(programs: Path):
    """The second build is the first one's file; --force builds again."""
    report = Recorder()
    first = build(report)
    assert first.built
    assert first.reference == REFERENCES["core"]
    assert "root file system: downloading packages with apt..." in report.texts
    assert "python3-rospy" in programs.read_text()
    programs.unlink()
    assert not build(report).built
    assert not programs.exists()
    assert build(report, force=True).built
    assert list(first.archive.parent.iterdir()) == [first.archive]


def test_variants(programs: Path):
    """Each variant has an archive of its own."""
    assert build(Recorder()).archive != build(Recorder(), variant="devel").archive


def test_failed_build(programs: Path, monkeypatch: pytest.MonkeyPatch):
    """mmdebstrap's own words are told, and nothing is left in the cache."""
    monkeypatch.setenv("FAIL", "1")
    with pytest.raises(CommandFailed, match="exit code 25") as failure:
        build(Recorder())
    assert "E: no such mirror" in failure.value.details
    assert failure.value.hint
    assert not list((programs.parent / "cache").rglob("*.tar"))


def test_no_mmdebstrap(programs: Path, monkeypatch: pytest.MonkeyPatch):
    """Without mmdebstrap and without the right to install it the error says how to get it."""
    monkeypatch.setenv("PATH", str(programs.parent))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(RigelK8sError, match="mmdebstrap") as failure:
        build(Recorder())
    assert "apt-get install mmdebstrap" in str(failure.value.hint)


def test_load_and_push(programs: Path, tmp_path: Path):
    """Podman is taken before docker; a registry without a certificate is said to podman."""
    image = BaseImage("localhost/a:1", tmp_path / "a.tar", built=False)
    assert load(image, Recorder()) == "podman"
    push(image, "10.0.0.1:5000/ros:noetic", Recorder(), plain_http=True)
    push(image, "10.0.0.1:5000/ros:noetic", Recorder(), engine="docker", plain_http=True)
    called = programs.read_text().splitlines()
    assert called[0] == f"podman load --input {tmp_path / 'a.tar'}"
    assert "podman tag localhost/a:1 10.0.0.1:5000/ros:noetic" in called
    assert "podman push --tls-verify=false 10.0.0.1:5000/ros:noetic" in called
    assert "docker push 10.0.0.1:5000/ros:noetic" in called


def test_failed_load(programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The engine's own words are told."""
    monkeypatch.setenv("FAIL", "1")
    with pytest.raises(CommandFailed, match="podman load") as failure:
        load(BaseImage("localhost/a:1", tmp_path / "a.tar", built=False), Recorder())
    assert failure.value.details == ("no space left",)


def test_no_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Without podman and docker the error says which to install."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RigelK8sError, match="neither podman nor docker") as failure:
        load(BaseImage("localhost/a:1", tmp_path / "a.tar", built=False), Recorder())
    assert "install podman" in str(failure.value.hint)


def test_executable_scripts():
    """The files that containers run are executable in the layer, whatever this checkout says."""
    modes = {e.path: e.mode for e in overlay.entries("core")}
    assert modes["ros_entrypoint.sh"] & stat.S_IXOTH
    assert modes["opt/ros/noetic/env.sh"] & stat.S_IXOTH
