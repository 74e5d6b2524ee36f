"""Which program builds, and what is said where none can."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from rigel_build.buildx import find_engine
from rigel_build.podman import Podman
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.system.process import finish

pytestmark = pytest.mark.programs

LACKING = "Uid:\t0\t0\t0\t0\nCapEff:\t000001fffeffffff\n"
WORKS = 'case "$*" in "buildx inspect --bootstrap") echo "Status: running";; esac'
NO_BUILDX = '[ "$1" = buildx ] && exit 1; exit 0'
NO_ENGINE = 'case "$*" in *inspect*) echo "Cannot connect to the daemon"; exit 1;; esac'


@pytest.fixture
def status(tmp_path: Path) -> Path:
    file = tmp_path / "status"
    file.write_text(LACKING)
    return file


def path_with(directory: Path, **programs: str) -> dict[str, str]:
    """A PATH with these programs, and no other."""
    place = directory / "bin"
    place.mkdir()
    for name, script in programs.items():
        (place / name).write_text(f"#!/bin/sh\n{script}\n")
        (place / name).chmod(0o755)
    return {"PATH": str(place)}


def test_auto_takes_docker_where_it_works(tmp_path: Path, status: Path) -> None:
    """docker is first, for what worked with Rigel keeps working the same way."""
    environ = path_with(tmp_path, docker=WORKS, podman="exit 0")
    assert find_engine("auto", environ, status).name == "docker"
    assert find_engine("podman", environ, status).name == "podman"


@pytest.mark.parametrize("docker", [NO_BUILDX, NO_ENGINE])
def test_auto_takes_podman_where_docker_cannot_build(
    docker: str, tmp_path: Path, status: Path
) -> None:
    """An installed docker that cannot build does not stand in podman's way."""
    environ = path_with(tmp_path, docker=docker, podman="exit 0")
    assert find_engine("auto", environ, status).name == "podman"


def test_a_docker_that_hangs_is_passed_over(
    tmp_path: Path, status: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An engine that never answers keeps nobody waiting, and is named as the reason."""

    def finish_soon(words: list[str], *, timeout: float, **more: Any) -> Any:
        return finish(words, timeout=0.3 if "inspect" in words else timeout, **more)

    monkeypatch.setattr("rigel_k8s.system.process.finish", finish_soon)
    hangs = '[ "$2" = version ] && exit 0; exec /bin/sleep 30'
    environ = path_with(tmp_path, docker=hangs, podman="exit 0")
    assert find_engine("auto", environ, status).name == "podman"
    with pytest.raises(RigelK8sError, match=r"inspect did not end within 0\.3 s"):
        find_engine("docker", environ, status)


@pytest.mark.parametrize(
    ("tool", "programs", "why"),
    [
        ("auto", {}, "docker is not installed; podman is not installed"),
        ("docker", {"podman": "exit 0"}, "docker is not installed$"),
        ("docker", {"docker": NO_BUILDX}, "without its buildx plugin"),
        ("docker", {"docker": NO_ENGINE}, "cannot reach .*Cannot connect to the daemon"),
        ("podman", {"podman": "echo broken; exit 1"}, "podman does not run .broken"),
    ],
)
def test_the_reasons_are_told(
    tool: str, programs: dict[str, str], why: str, tmp_path: Path, status: Path
) -> None:
    """Where nothing can build, each program's reason is told, and what to install."""
    environ = path_with(tmp_path, **programs)
    with pytest.raises(RigelK8sError, match=why) as caught:
        find_engine(tool, environ, status)
    assert "apt-get install podman" in str(caught.value.hint)


@pytest.mark.skipif(shutil.which("docker") is None, reason="docker's command line is not here")
def test_the_real_docker_is_asked_without_harm(tmp_path: Path) -> None:
    """docker's command line without an engine to reach is a reason, not a traceback."""
    nowhere = {"DOCKER_HOST": f"unix://{tmp_path}/none.sock", "DOCKER_CONFIG": str(tmp_path)}
    with pytest.raises(RigelK8sError, match="docker"):
        find_engine("docker", {**os.environ, **nowhere})


def test_isolation_is_set_unless_the_user_did(tmp_path: Path, status: Path) -> None:
    """A root without CAP_SYS_RESOURCE builds with chroot; BUILDAH_ISOLATION of the user's wins."""
    environ = path_with(tmp_path, podman="exit 0")
    podman = str(shutil.which("podman", path=environ["PATH"]))
    assert find_engine("podman", environ, status) == Podman(podman, isolation="chroot")
    environ["BUILDAH_ISOLATION"] = "rootless"
    assert find_engine("podman", environ, status) == Podman(podman)
