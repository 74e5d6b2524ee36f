"""The user's kubeconfig keeps all that is not ours."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.errors import UserError
from rigel_lab.cluster import kubeconfig


def ours(context: str) -> dict[str, Any]:
    named = {"name": context}
    return {
        "clusters": [{**named, "cluster": {}}],
        "users": [{**named, "user": {}}],
        "contexts": [{**named, "context": {"cluster": context, "user": context}}],
    }


def theirs(path: Path, current: str = "robots") -> dict[str, Any]:
    content = {"apiVersion": "v1", "kind": "Config", **ours("robots"), "current-context": current}
    path.write_text(yaml.safe_dump(content))
    return content


def test_merge_and_remove_give_back_what_was(tmp_path: Path) -> None:
    """After remove everything is as before merge, the current context too."""
    path = tmp_path / "config"
    before = theirs(path)
    assert kubeconfig.merge(path, "rigel-a", ours("rigel-a")) == "robots"
    assert kubeconfig.load(path)["current-context"] == "rigel-a"
    kubeconfig.remove(path, "rigel-a", "robots")
    assert kubeconfig.load(path) == before


def test_a_file_of_ours_alone_is_removed(tmp_path: Path) -> None:
    """Where there was no kubeconfig, nor ~/.kube, there is none afterwards."""
    path = tmp_path / ".kube" / "config"
    assert kubeconfig.merge(path, "rigel-a", ours("rigel-a")) is None
    assert path.stat().st_mode & 0o777 == 0o600
    kubeconfig.remove(path, "rigel-a", None)
    assert not path.parent.exists()


def test_merge_twice_is_merge_once(tmp_path: Path) -> None:
    """A second merge replaces the entries and does not forget the context before the first."""
    path = tmp_path / "config"
    theirs(path)
    kubeconfig.merge(path, "rigel-a", ours("rigel-a"))
    assert kubeconfig.merge(path, "rigel-a", ours("rigel-a")) is None
    assert [c["name"] for c in kubeconfig.load(path)["contexts"]] == ["robots", "rigel-a"]


def test_a_context_chosen_meanwhile_stays(tmp_path: Path) -> None:
    """Where the user went to another context, remove leaves that one current."""
    path = tmp_path / "config"
    theirs(path)
    kubeconfig.merge(path, "rigel-a", ours("rigel-a"))
    content = kubeconfig.load(path)
    kubeconfig.save(path, {**content, "current-context": "robots"})
    kubeconfig.remove(path, "rigel-a", None)
    assert kubeconfig.load(path)["current-context"] == "robots"


@pytest.mark.parametrize("text", ["y", "n", "1e3", "0o17", "1_000", "12:30", "=", "~", "on", "10"])
def test_texts_stay_texts_for_kubectl(tmp_path: Path, text: str) -> None:
    """What a YAML 1.1 reader takes for a boolean or a number is quoted, also in others' entries."""
    path = tmp_path / "config"
    path.write_text(f'users:\n- {{name: u, user: {{password: "{text}"}}}}\n')
    kubeconfig.merge(path, "rigel-a", ours("rigel-a"))
    assert f'password: "{text}"\n' in path.read_text()


def test_times_stay_what_they_are(tmp_path: Path) -> None:
    """A token's expiry is neither reformatted nor turned into another type."""
    path = tmp_path / "config"
    path.write_text("users:\n- name: u\n  user: {expiry: 2026-01-02T03:04:05Z}\n")
    kubeconfig.merge(path, "rigel-a", ours("rigel-a"))
    assert '"2026-01-02T03:04:05Z"' in path.read_text()


def test_links_owner_and_mode_stay(tmp_path: Path) -> None:
    """A symbolic link stays one; the file keeps its mode and owner."""
    target = tmp_path / "dotfiles"
    theirs(target)
    target.chmod(0o640)
    path = tmp_path / "config"
    path.symlink_to(target)
    kubeconfig.merge(path, "rigel-a", ours("rigel-a"))
    assert path.is_symlink()
    assert target.stat().st_mode & 0o777 == 0o640
    assert "rigel-a" in target.read_text()


@pytest.mark.parametrize("text", ["- a\n- b\n", "a: [\n", "clusters: yes\n", "contexts: [1]\n"])
def test_what_is_no_kubeconfig_is_refused(tmp_path: Path, text: str) -> None:
    """A file that we do not understand is named and not touched."""
    path = tmp_path / "config"
    path.write_text(text)
    with pytest.raises(UserError, match=str(path)):
        kubeconfig.merge(path, "rigel-a", ours("rigel-a"))
    assert path.read_text() == text


def test_which_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of $KUBECONFIG, else that of sudo's user, else one's own."""
    monkeypatch.setenv("HOME", str(tmp_path))
    user = kubeconfig.user_kubeconfig
    assert user({"KUBECONFIG": f"{os.pathsep}/a{os.pathsep}/b"}) == Path("/a")
    assert user({"KUBECONFIG": "", "SUDO_USER": "root"}) == Path("/root/.kube/config")
    assert user({}) == tmp_path / ".kube" / "config"
