"""`rigel bags`: copies are whole or not there, and what is being written is left alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from rigel_k8s.cli.bags import length, size, stamp
from rigel_k8s.commands import bags
from rigel_k8s.commands.targets import Release
from rigel_k8s.commands.targets import Warnings as Report
from rigel_k8s.errors import ClusterError, RigelK8sError, UserError
from rigel_k8s.kube.execution import ExecResult
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings

OLD, NEW, NOW = (f"2026-01-01-00-0{number}-00_{number}.bag" for number in range(3))


def described(name: str, files: Mapping[str, bytes], state: str = "closed") -> dict[str, Any]:
    """Return what record.py describes."""
    sizes = [[path, len(content)] for path, content in files.items()]
    total = sum(map(len, files.values()))
    own = {"started": 1.7e9, "seconds": 60.0, "size": total, "files": sizes}
    return {"name": name, "state": state, **own}


class Cluster:
    """A pod with bags: name -> (state, path -> content)."""

    def __init__(self) -> None:
        self.bags: dict[str, tuple[str, dict[str, bytes]]] = {
            OLD: ("closed", {OLD: b"old"}),
            NEW: ("repaired", {NEW: b"new"}),
            NOW: ("recording", {f"{NOW}.active": b"now"}),
        }
        self.running = True
        self.claims: list[dict[str, Any]] = []
        self.short = False
        self.calls: list[str] = []

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def list(self, api: str, kind: str, *_: object, **__: object) -> list[dict[str, Any]]:
        """Return the recorder's pod, or the claims."""
        if kind != "Pod":
            return self.claims
        label = {"app.kubernetes.io/name": "recorder"}
        pod = {
            "metadata": {"name": "recorder-1", "namespace": "lab", "labels": label},
            "spec": {"containers": [{"name": "ros-node"}]},
            "status": {"phase": "Running"},
        }
        return [pod] if self.running else []

    def run(self, namespace: str, pod: str, command: Sequence[str], **_: object) -> ExecResult:
        """Run record.py."""
        assert list(command[:3]) == ["/bin/sh", "/rigel-k8s/record.sh", "/persistent/bags"]
        self.calls.append(" ".join(command[3:]))
        found = [described(name, files, state) for name, (state, files) in self.bags.items()]
        if command[3] == "delete" and NOW in command:
            return ExecResult(1, b"", f"{NOW} is being written\n".encode())
        return ExecResult(0, json.dumps(found).encode(), b"")

    def exec(
        self,
        namespace: str,
        pod: str,
        command: Sequence[str],
        *,
        stdout: BinaryIO,
        stderr: BinaryIO,
        **_: object,
    ) -> int:
        """Run `cat`."""
        path = command[-1].removeprefix("/persistent/bags/")
        content = {k: v for _, files in self.bags.values() for k, v in files.items()}
        if path not in content:
            stderr.write(b"cat: no such file\n")
            return 1
        stdout.write(content[path][: 1 if self.short else None])
        return 0


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Cluster:
    """A cluster with a release."""
    made = Cluster()
    found = Release(made, ReleaseId("lab", "app"))  # type: ignore[arg-type]
    monkeypatch.setattr(bags, "release", lambda *_: found)
    return made


def fetch(to: Path, *names: str, last: int | None = None) -> list[str]:
    """Fetch bags, and return the warnings."""
    report = Report()
    bags.fetch(Settings(), None, names, last, to, report)
    return report.texts


def content(folder: Path) -> dict[str, str]:
    """Return all files below a folder."""
    found = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_text() for path in found}


def test_all_closed_bags(cluster: Cluster, tmp_path: Path) -> None:
    """Into a folder that is made for them; the one that is being written stays there."""
    assert fetch(tmp_path / "to") == []
    assert content(tmp_path / "to") == {OLD: "old", NEW: "new"}


def test_the_newest(cluster: Cluster, tmp_path: Path) -> None:
    fetch(tmp_path, last=1)
    assert content(tmp_path) == {NEW: "new"}


def test_the_one_that_is_being_written(cluster: Cluster, tmp_path: Path) -> None:
    """Only by its name, and called as the recorder calls it."""
    (warning,) = fetch(tmp_path, NOW)
    assert "is being written" in warning
    assert content(tmp_path) == {f"{NOW}.active": "now"}


def test_a_folder_of_ros2(cluster: Cluster, tmp_path: Path) -> None:
    """All its files, and none outside of it."""
    cluster.bags = {"run_0": ("closed", {"run_0/run_0.mcap": b"m", "../metadata.yaml": b"y"})}
    fetch(tmp_path / "to")
    assert content(tmp_path) == {"to/run_0/run_0.mcap": "m", "to/run_0/metadata.yaml": "y"}


def test_a_bag_that_is_here_is_not_copied_again(cluster: Cluster, tmp_path: Path) -> None:
    (tmp_path / OLD).write_text("mine")
    fetch(tmp_path)
    assert content(tmp_path) == {OLD: "mine", NEW: "new"}


def test_an_incomplete_copy_is_not_left(cluster: Cluster, tmp_path: Path) -> None:
    """Neither under the bag's name nor under another one."""
    cluster.short = True
    with pytest.raises(ClusterError, match=f"the copy of {OLD} is incomplete: 1 of 3 bytes"):
        fetch(tmp_path)
    assert content(tmp_path) == {}


def test_a_bag_that_was_deleted_meanwhile(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit may do that."""
    gone = [bags.Bag("gone.bag", "closed", None, None, 3, {"gone.bag": 3})]
    monkeypatch.setattr(bags.Recorder, "list", lambda _: gone)
    with pytest.raises(ClusterError, match="cannot be read") as caught:
        fetch(tmp_path)
    assert caught.value.details == ("cat: no such file",)
    assert content(tmp_path) == {}


def test_a_folder_that_cannot_be_written(cluster: Cluster, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RigelK8sError, match=r"cannot write to .*file/to: Not a directory"):
        fetch(tmp_path / "file" / "to")


def test_a_name_that_is_none(cluster: Cluster, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=f'no bag "{OLD}x", did you mean "{OLD}"'):
        fetch(tmp_path, OLD + "x")


def test_deleting_what_is_being_written(cluster: Cluster) -> None:
    """The pod refuses, and its line is the error."""
    recorder = bags.open_recorder(Settings(), None)
    with pytest.raises(UserError, match="is being written"):
        bags.delete(recorder, bags.choose(recorder.list(), [OLD, NOW]))
    bags.delete(recorder, [])
    assert cluster.calls[-1] == f"delete {OLD} {NOW}"


def test_a_script_that_ends_without_a_word(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that Kubernetes kills."""
    monkeypatch.setattr(cluster, "run", lambda *_, **__: ExecResult(137, b"", b""))
    with pytest.raises(UserError, match="ended with exit code 137"):
        bags.list_bags(Settings(), None)


def test_a_recorder_that_does_not_run(cluster: Cluster) -> None:
    """The volume is there after `rigel down`; without one nothing was recorded."""
    cluster.running = False
    with pytest.raises(UserError, match="app records no bags in the namespace lab"):
        bags.list_bags(Settings(), None)
    cluster.claims = [{}]
    with pytest.raises(UserError, match=r"does not run in lab.* on the volume bags-pvc") as caught:
        bags.list_bags(Settings(), None)
    assert "rigel run" in str(caught.value.hint)


def test_numbers_for_people() -> None:
    assert [length(s) for s in (None, 0.4, 59.6, 3725)] == ["-", "0s", "1m00s", "1h02m"]
    assert [size(n) for n in (12, 2048, 40 * 2**20, 5 * 2**30)] == [
        *("12 B", "2.0 KiB", "40 MiB", "5.0 GiB")
    ]
    assert [stamp(None), stamp(0)] == ["-", "1970-01-01 00:00:00Z"]
