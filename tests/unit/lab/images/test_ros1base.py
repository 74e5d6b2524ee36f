"""The ROS 1 base image without building it: the overlay, the archive's format, and the cache."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import tarfile
from pathlib import Path

import attrs
import pytest

from rigel_k8s.errors import CommandFailed, RigelK8sError
from rigel_k8s.system.oci import read_archive
from rigel_lab.images.base.build import EPOCH, Recipe
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.delivery import deliver
from rigel_lab.images.ros1base import REFERENCES, BaseImage, build, recipe
from rigel_lab.images.ros1base.packages import PACKAGES
from tests.support.recorder import Recorder

pytestmark = pytest.mark.programs

MMDEBSTRAP = """#!/bin/sh
echo "I: downloading packages with apt..." >&2
for target; do :; done
[ -n "$FAIL" ] && { echo "E: no such mirror" >&2; exit 25; }
printf '%s\\n' "$*" "$SOURCE_DATE_EPOCH" >"$LOG"
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
    """What Dockerfiles and Rigelfiles name of the official image is there, and is executable."""
    found = files(recipe.layer("core", mtime=0))
    assert found["ros_entrypoint.sh"].mode == found["opt/ros/noetic/env.sh"].mode == 0o755
    assert found["opt/ros/noetic/bin/roscore"].linkname == "/usr/bin/roscore"
    assert {f"opt/ros/noetic/setup.{shell}" for shell in ("sh", "bash", "zsh")} <= set(found)
    assert recipe.CONFIG["Entrypoint"] == ["/ros_entrypoint.sh"]
    assert "ROS_DISTRO=noetic" in recipe.CONFIG["Env"]


def test_descriptions():
    """Packages whose package.xml Debian ships with the headers get one, unless the headers come."""
    description = "usr/share/std_msgs/package.xml"
    assert description in files(recipe.layer("core", mtime=0))
    assert description not in files(recipe.layer("devel", mtime=0))
    assert "libstd-msgs-dev" in PACKAGES["devel"]


@pytest.mark.parametrize("shell", ["sh", "bash"])
@pytest.mark.parametrize("before", ["", "/opt/ros/noetic:/elsewhere"])
def test_setup(shell: str, before: str):
    """Sourced once or twice, in sh or bash, with -eu: the same environment."""
    setup = Path(recipe.__file__).parent / "files" / "setup.sh"
    script = f'set -eu; . {setup}; . {setup}; echo "$PATH $ROS_PACKAGE_PATH $CMAKE_PREFIX_PATH"'
    env = {"PATH": "/usr/bin:/bin", **({"CMAKE_PREFIX_PATH": before} if before else {})}
    done = subprocess.run([shell, "-c", script], capture_output=True, text=True, env=env)
    expected = "/opt/ros/noetic/bin:/usr/bin:/bin /opt/ros/noetic/share /opt/ros/noetic\n"
    assert (done.stdout, done.stderr) == (expected, "")


def test_same_bytes():
    """The same files give the same layer, so an unchanged image keeps its digest."""
    assert recipe.layer("core", mtime=7) == recipe.layer("core", mtime=7)


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


@pytest.mark.parametrize("arch", ["amd64", "arm64"])
def test_an_image_is_built_for_the_machines_that_run_it(programs: Path, arch: str):
    """Its programs, and what it says of itself, are of the requested architecture."""
    archive = build(Recorder(), arch=arch).archive
    assert f"--architectures={arch}" in programs.read_text()
    with tarfile.open(archive) as tar:
        assert json.loads(read_archive(tar).config.read())["architecture"] == arch
    assert archive != build(Recorder(), arch={"amd64": "arm64", "arm64": "amd64"}[arch]).archive


def test_another_overlay_is_another_archive(programs: Path):
    """A change of what is laid over the packages is built, not taken from the cache."""
    base = Recipe("t", "family", "name", "localhost/a:1", "bookworm", ["a"], {}, b"")
    changes = [
        {},
        {"overlay": b"1"},
        {"locked": b"2"},
        {"packages": ["b"]},
        {"config": {"User": "1"}},
    ]
    recipes = [attrs.evolve(base, **change) for change in changes]  # type: ignore[arg-type]
    assert len({build_recipe(recipe, Recorder()).archive for recipe in recipes}) == len(recipes)


def test_no_file_is_younger_than_the_epoch(programs: Path):
    """mmdebstrap is told the time, so that the same packages are the same bytes."""
    build(Recorder())
    assert programs.read_text().splitlines()[-1] == str(EPOCH)


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


def test_load_and_push(programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Podman is taken before docker, which serves where podman is not installed."""
    image = BaseImage("localhost/a:1", tmp_path / "a.tar", built=False)
    assert deliver(image, None, Recorder()) == "localhost/a:1"
    assert deliver(image, "10.0.0.1:5000/ros:noetic", Recorder()) == "10.0.0.1:5000/ros:noetic"
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "which", lambda name: None if name == "podman" else name)
        deliver(image, "10.0.0.1:5000/ros:noetic", Recorder())
    called = programs.read_text().splitlines()
    assert called[0] == f"podman load --input {tmp_path / 'a.tar'}"
    assert "podman tag localhost/a:1 10.0.0.1:5000/ros:noetic" in called
    assert "podman push 10.0.0.1:5000/ros:noetic" in called
    assert "docker push 10.0.0.1:5000/ros:noetic" in called


def test_failed_load(programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The engine's own words are told."""
    monkeypatch.setenv("FAIL", "1")
    with pytest.raises(CommandFailed, match="podman load") as failure:
        deliver(BaseImage("localhost/a:1", tmp_path / "a.tar", built=False), None, Recorder())
    assert failure.value.details == ("no space left",)


def test_no_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Without podman and docker the error says which to install."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RigelK8sError, match="neither podman nor docker") as failure:
        deliver(BaseImage("localhost/a:1", tmp_path / "a.tar", built=False), None, Recorder())
    assert "install podman" in str(failure.value.hint)
