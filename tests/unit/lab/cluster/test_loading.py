"""Where images come from."""

from __future__ import annotations

from pathlib import Path

import pytest

from rigel_k8s.errors import CommandFailed, UserError
from rigel_lab.cluster.loading import archive, engine_commands

pytestmark = pytest.mark.programs


def engine(directory: Path, name: str, script: str) -> None:
    program = directory / name
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only directory of programs."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("SUDO_USER", raising=False)
    return tmp_path


def test_a_file_is_taken_as_it_is(tmp_path: Path) -> None:
    """No engine is asked for what is a file."""
    path = tmp_path / "image.tar"
    path.touch()
    with archive(str(path)) as found:
        assert found == path


def test_the_first_engine_that_has_it_saves_it(programs: Path) -> None:
    """Podman lacks the image, docker has it."""
    engine(programs, "podman", "echo 'no such image' >&2; exit 125")
    engine(programs, "docker", 'test "$*" = "save x:1" && echo saved')
    with archive("x:1") as found:
        assert found.read_text() == "saved\n"
    assert not found.exists()


def test_nobody_has_it(programs: Path) -> None:
    """The error says what each engine said."""
    engine(programs, "podman", "echo 'x:1: image not known' >&2; exit 125")
    with pytest.raises(UserError, match="no file and no image x:1") as caught, archive("x:1"):
        pass
    assert caught.value.details == ("podman: x:1: image not known",)


def test_nobody_to_ask(programs: Path) -> None:
    """Without an engine the error asks for a file."""
    with pytest.raises(UserError, match="neither podman nor docker") as caught, archive("x:1"):
        pass
    assert "docker save" in (caught.value.hint or "")


def test_a_node_that_refuses_is_not_blamed_on_the_engine(programs: Path) -> None:
    """A failure while the archive is used is told as it is."""
    engine(programs, "podman", "echo saved")
    with pytest.raises(CommandFailed, match="ctr refused"), archive("x:1"):
        raise CommandFailed("ctr refused")


def test_under_sudo_the_users_own_images_are_seen(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rootless podman's images belong to the user who said sudo."""
    engine(programs, "podman", "")
    monkeypatch.setenv("SUDO_USER", "ann")
    assert list(engine_commands()) == [["runuser", "-u", "ann", "--", "podman"], ["podman"]]
