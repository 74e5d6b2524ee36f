"""`rigel dev`: which files are copied, what a copy contains, and the Deployment meanwhile."""

from __future__ import annotations

import io
import os
import tarfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rigel_k8s.app.development import REQUESTS, wrap_deployment
from rigel_k8s.commands.dev import files, session
from rigel_k8s.commands.dev.files import Folder, compare, list_files, pack, read_folder
from rigel_k8s.commands.dev.session import Life, Session
from rigel_k8s.commands.pods import pod_of
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.marks import DEVELOPMENT_ANNOTATION
from rigel_k8s.release import development
from rigel_k8s.release.types import DeployOptions, ReleaseId
from rigel_k8s.settings import Settings
from tests.support.recorder import Recorder


def test_a_folder_and_its_place(tmp_path: Path) -> None:
    """A path of this computer may have a colon; that of the container has none."""
    (tmp_path / "a:b").mkdir()
    assert read_folder(f"{tmp_path}/a:b:/ws/src") == Folder(
        tmp_path / "a:b", PurePosixPath("/ws/src")
    )


@pytest.mark.parametrize("text", ["src", "src:", "src:ws", ":/ws", "src:/", "src:/ws/../etc"])
def test_a_place_that_is_none(text: str) -> None:
    with pytest.raises(UserError, match="invalid folder"):
        read_folder(text)


def test_a_folder_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="gone is not a folder"):
        read_folder(f"{tmp_path}/gone:/ws")


@pytest.mark.parametrize("place", ["/ws/a.py", "/ws"])
def test_a_file_is_refused_with_its_folder(tmp_path: Path, place: str) -> None:
    (tmp_path / "a.py").touch()
    with pytest.raises(UserError, match="is not a folder") as caught:
        read_folder(f"{tmp_path}/a.py:{place}")
    assert caught.value.hint == f"copy its folder: --sync {tmp_path}:/ws"


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    """A workspace with what belongs into the container and what does not."""
    for name in (
        "a.py",
        ".clang-format",
        "sub/b.py",
        "a.py~",
        ".a.py.swp",
        ".git/index",
        "__pycache__/a.pyc",
        "sub/build/x",
        "install/x",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / "link").symlink_to("a.py")
    os.mkfifo(tmp_path / "fifo")
    return Folder(tmp_path, PurePosixPath("/ws"))


def test_what_belongs_into_the_container(folder: Folder) -> None:
    found = list_files([folder])
    assert sorted(found) == ["/ws/.clang-format", "/ws/a.py", "/ws/link", "/ws/sub/b.py"]


def test_a_folder_that_is_too_large(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not copied does not count."""
    monkeypatch.setattr(files, "LARGEST", 50)
    files.check_size([folder])
    (folder.local / "map").write_bytes(b"x" * 60)
    with pytest.raises(UserError, match="has 0 MiB of files to copy"):
        files.check_size([folder])


def test_changes_are_found_by_what_is_there(folder: Folder) -> None:
    """A new, a changed, an executable and a removed file; a file that was saved unchanged."""
    before = list_files([folder])
    assert compare({}, before) == (list(before), [])
    assert compare(before, list_files([folder])) == ([], [])
    (folder.local / "new").write_text("")
    os.utime(folder.local / "a.py", ns=(1, 1))
    (folder.local / "sub" / "b.py").chmod(0o755)
    (folder.local / ".clang-format").unlink()
    changed, removed = compare(before, list_files([folder]))
    assert (sorted(changed), removed) == (
        ["/ws/a.py", "/ws/new", "/ws/sub/b.py"],
        ["/ws/.clang-format"],
    )


def test_a_copy_has_the_files_and_what_to_remove(folder: Folder) -> None:
    """A file that has gone since is left out; links stay links."""
    found = list_files([folder])
    (folder.local / ".clang-format").unlink()
    data = pack(found, found, ["/ws/old", "/ws/o ld"], "/run/x")
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        members = {member.name: member for member in archive}
        assert sorted(members) == ["run/x/removed", "ws/a.py", "ws/link", "ws/sub/b.py"]
        assert members["ws/link"].linkname == "a.py"
        note = archive.extractfile("run/x/removed")
        assert note is not None
        assert note.read() == b"/ws/old\0/ws/o ld\0"


def test_a_script_is_executable_as_a_build_installs_it(tmp_path: Path) -> None:
    (tmp_path / "talker.py").write_text("#!/usr/bin/env python3\n")
    (tmp_path / "plain.py").write_text("import this\n")
    for file in tmp_path.iterdir():
        file.chmod(0o640)
    found = list_files([Folder(tmp_path, PurePosixPath("/ws"))])
    with tarfile.open(fileobj=io.BytesIO(pack(found, found, [], "/run/x"))) as archive:
        modes = {member.name: member.mode for member in archive}
    assert (modes["ws/talker.py"], modes["ws/plain.py"]) == (0o751, 0o640)


def deployment(**container: Any) -> dict[str, Any]:
    """Return a Deployment of a node that hands over."""
    env = [
        {"name": "RIGEL_K8S_PEERS", "value": "motor-pods"},
        {"name": "RIGEL_K8S_WORKLOAD", "value": "lab/arm/motor"},
        {"name": "ROS_MASTER_URI", "value": "http://ros-master:11310"},
        {"name": "OWN", "value": "1"},
    ]
    own = {"name": "ros-node", "env": env, "livenessProbe": {"exec": {}}, **container}
    spec = {
        "replicas": 2,
        "strategy": {"type": "RollingUpdate"},
        "template": {"spec": {"containers": [own, {"name": "sidecar", "args": ["y"]}]}},
    }
    return {"kind": "Deployment", "metadata": {"name": "motor"}, "spec": spec}


def test_a_deployment_in_development() -> None:
    """One pod, which waits for no other; the program starts below dev.sh; nothing else changes."""
    made = wrap_deployment(deployment(args=["ros2", "run"]), "ros-node", "me since now")
    note = {"rigel-k8s/development": "me since now"}
    assert made["metadata"]["annotations"] == note
    assert made["spec"]["template"]["metadata"]["annotations"] == note
    assert (made["spec"]["strategy"], made["spec"]["replicas"]) == ({"type": "Recreate"}, 1)
    node, sidecar = made["spec"]["template"]["spec"]["containers"]
    assert node["args"] == ["/bin/sh", "/rigel-k8s/dev.sh", REQUESTS, "ros2", "run"]
    assert node["env"] == [
        {"name": "ROS_MASTER_URI", "value": "http://ros-master:11311"},
        {"name": "OWN", "value": "1"},
    ]
    assert "livenessProbe" not in node
    assert sidecar == {"name": "sidecar", "args": ["y"]}


def test_a_command_has_the_script_before_its_args() -> None:
    made = wrap_deployment(deployment(command=["python3"], args=["a.py"]), "ros-node", "")
    node = made["spec"]["template"]["spec"]["containers"][0]
    assert node["command"] == ["/bin/sh", "/rigel-k8s/dev.sh", REQUESTS, "python3"]
    assert node["args"] == ["a.py"]


def test_a_folder_that_files_mounts_can_be_copied_to() -> None:
    """It is an empty one meanwhile; other mounts stay as they are."""
    mounts = [
        {"name": "files-0", "mountPath": "/app", "subPath": "app", "readOnly": True},
        {"name": "files-1", "mountPath": "/app/x.json", "subPath": "x.json", "readOnly": True},
        {"name": "maps", "mountPath": "/maps"},
    ]
    manifest = deployment(args=["a"], volumeMounts=mounts)
    spec = wrap_deployment(manifest, "ros-node", "", ["/app/", "/maps"])["spec"]["template"]["spec"]
    first, *others = spec["containers"][0]["volumeMounts"]
    assert first == {"name": "rigel-dev-0", "mountPath": "/app"}
    assert others[:2] == mounts[1:]
    assert {"name": "rigel-dev-0", "emptyDir": {}} in spec["volumes"]
    assert mounts[0]["readOnly"]


def test_a_file_that_files_mounts_gives_way_to_its_copy() -> None:
    """A copy cannot replace a mounted file; a mount stays if nothing is copied to its place."""
    paths = ["/app/a.py", "/app/lib", "/app/x.json", "/app.py", "/rigel-k8s"]
    mounts = [{"name": "f", "mountPath": path, "readOnly": True} for path in paths]
    mounts.append({"name": "log", "mountPath": "/app/log"})
    manifest = deployment(args=["a"], volumeMounts=mounts)
    copied = ["/app/a.py", "/app/lib/b.py", "/app/log/c"]
    made = wrap_deployment(manifest, "ros-node", "", ["/app"], copied)
    left = [
        one["mountPath"]
        for one in made["spec"]["template"]["spec"]["containers"][0]["volumeMounts"]
    ]
    assert left == ["/app/x.json", "/app.py", "/rigel-k8s", "/app/log", "/run/rigel-dev"]


def test_a_folder_below_one_that_files_mounts_is_refused() -> None:
    """Without the mount its other files would be missing, and nothing can be copied into it."""
    mounts = [{"name": "f", "mountPath": "/app", "readOnly": True}]
    manifest = deployment(args=["a"], volumeMounts=mounts)
    with pytest.raises(UserError, match="/app/sub is in /app, which is mounted") as caught:
        wrap_deployment(manifest, "ros-node", "", ["/app/sub"], ["/app/sub/a.py"])
    assert "--sync DIR:/app" in str(caught.value.hint)


def test_a_session_passes_what_it_copies(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """So a file that `files` mounts is not in the way of the first copy."""
    mounts = [{"name": "f", "mountPath": "/ws/a.py", "readOnly": True}]
    manifest = deployment(args=["a"], volumeMounts=mounts)
    made = []

    def apply(*arguments: Any) -> AbstractContextManager[None]:
        made.append(arguments[4](manifest))
        return nullcontext()

    cluster = Container(copying=0)
    found = Release(cast(Any, cluster), ReleaseId("n", "lab"))
    monkeypatch.setattr(session, "release", lambda *_: found)
    monkeypatch.setattr(session, "pods_of", lambda *_: [pod_of(cluster.list()[0])])
    monkeypatch.setattr(session, "check_script", lambda *_: None)
    monkeypatch.setattr(
        session, "writing", lambda *_: nullcontext(DeployOptions(report=Recorder()))
    )
    monkeypatch.setattr(development, "changed", apply)
    monkeypatch.setattr(Session, "run", lambda _: None)
    session.develop(Settings(Path("Rigelfile")), "motor", [folder], (), Recorder(), print)
    (only,) = made[0]["spec"]["template"]["spec"]["containers"][0]["volumeMounts"]
    assert only["mountPath"] == "/run/rigel-dev"


class Container:
    """A cluster whose one running container refuses copies or commands."""

    def __init__(self, copying: int, command: int = 0) -> None:
        self.codes = copying, command
        self.ended = threading.Event()

    def list(self, *_: Any, **__: Any) -> list[dict[str, Any]]:
        """Return its pod."""
        state = {"name": "ros-node", "containerID": "1", "restartCount": 0}
        state |= {"state": {"running": {}}}
        meta = {"name": "motor-1", "namespace": "n", "annotations": {DEVELOPMENT_ANNOTATION: "me"}}
        spec = {"containers": [{"name": "ros-node"}]}
        return [{"metadata": meta, "spec": spec, "status": {"containerStatuses": [state]}}]

    def logs(self, *_: Any, **__: Any) -> Iterator[str]:
        """Print nothing until its end."""
        self.ended.wait(60)
        yield from ()

    def run(self, *_: Any, **__: Any) -> SimpleNamespace:
        """Copy."""
        return SimpleNamespace(code=self.codes[0], stderr=b"tar: a: Cannot open\ntar: end\n")

    def exec(self, *_: Any, **__: Any) -> int:
        """Run the command."""
        return self.codes[1]


def session_with(cluster: Container, folder: Folder, command: Sequence[str] = ()) -> Session:
    """Return a session of the node motor."""
    pod = pod_of(cluster.list()[0])
    found = Release(cast(Any, cluster), ReleaseId("n", "lab"))
    options = DeployOptions(report=Recorder(), cancel=cluster.ended)
    return Session(found, pod, pod.owner, "me", [folder], command, options, print)


def test_a_first_copy_that_fails_ends_the_session(folder: Folder) -> None:
    """The program has not started: it must not be called running."""
    cluster = Container(copying=2)
    with pytest.raises(ClusterError, match="the program has not started: cannot copy: tar: a") as e:
        session_with(cluster, folder).run()
    cluster.ended.set()
    assert "tar: end" not in e.value.message
    assert "can write to" in str(e.value.hint)


def test_what_goes_on_after_a_failure(folder: Folder) -> None:
    """A first command that fails leaves the start to dev.sh; later the old program goes on."""
    cluster = Container(copying=0, command=1)
    one = session_with(cluster, folder, ["make"])
    life, found = Life(one.pod, "1"), list_files([folder])
    one.update(life, found)
    one.update(life, {})
    warnings = cast(Recorder, one.options.report).warnings
    assert "make has ended with exit code 1; the program starts without that" in warnings[0]
    assert "the program goes on as it was" in warnings[1]
    assert life.failure is None


@pytest.mark.parametrize("container", [{}, {"args": ["--verbose"]}])
def test_what_the_image_runs_is_refused(container: dict[str, Any]) -> None:
    with pytest.raises(UserError, match="motor runs what its image names"):
        wrap_deployment(deployment(**container), "ros-node", "")
