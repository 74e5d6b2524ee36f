"""Machines and names that cannot work are refused with the way out."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import pytest

from rigel_k8s.errors import LocalClusterError, UserError
from rigel_lab.cluster import components, requirements
from rigel_lab.cluster.requirements import check_name, require_disk, require_host


def test_other_systems_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """On macOS the error names what works there."""
    monkeypatch.setattr(platform, "system", lambda: "Darwin")
    with pytest.raises(UserError, match="needs Linux") as caught:
        require_host()
    assert caught.value.hint is not None
    assert all(word in caught.value.hint for word in ("kind", "minikube", "k3s"))


def test_other_users_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without root the error says why it is needed, and what works without."""
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(UserError, match="needs root") as caught:
        require_host()
    assert caught.value.hint is not None
    assert all(word in caught.value.hint for word in ("sudo", "kind", "minikube", "k3s"))


def test_missing_programs_are_named_by_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hint is a command that installs what is missing."""
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(requirements, "PROGRAMS", {"no-such-program": "its-package", "sh": "dash"})
    with pytest.raises(UserError, match="needs its-package") as caught:
        require_host()
    assert caught.value.hint == "apt-get install its-package"


def test_overlay_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Images cannot be laid on overlay; that is told before anything is tried."""
    monkeypatch.setattr(requirements, "run", lambda _: "overlayfs\n")
    with pytest.raises(UserError, match="overlayfs"):
        require_disk(tmp_path / "not" / "there")


@pytest.mark.programs
def test_this_disk_is_accepted(tmp_path: Path) -> None:
    """An ordinary directory passes, also before it is made."""
    require_disk(tmp_path / "not" / "there")


def test_a_machine_without_apt_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Debian's packages are not to be had, other clusters are named."""
    monkeypatch.setattr(components.shutil, "which", lambda _: None)
    with pytest.raises(LocalClusterError, match="no apt-get") as caught:
        components.require_apt()
    assert "k3s" in (caught.value.hint or "")


@pytest.mark.parametrize("name", ["local", "a", "t-one-2", "x" * 30])
def test_good_names(name: str) -> None:
    """Letters, digits and single dashes."""
    check_name(name)


@pytest.mark.parametrize("name", ["", "A", "1a", "-a", "a-", "a--b", "a_b", "a/b", "é", "x" * 31])
def test_bad_names(name: str) -> None:
    """What cannot be a context, a cgroup or a path is refused."""
    with pytest.raises(UserError, match="is not a name for a local cluster"):
        check_name(name)
