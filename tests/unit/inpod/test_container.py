"""Whose processes and ports these are: the container's own command's, or a visitor's."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest

SHELL, NODE, TOOL, CHILD = 1, 8, 40, 41


@pytest.fixture
def proc(tmp_path: Path, script: Callable[[str], ModuleType]) -> Proc:
    return Proc(tmp_path, script("container"))


class Proc:
    """A /proc of processes and their listening sockets."""

    def __init__(self, folder: Path, container: ModuleType) -> None:
        self.folder, self.container = folder, container
        container.PROC = str(folder)  # type: ignore[attr-defined]
        self._tables: list[str] = ["sl local rem st ..."]
        self._group(folder / "self", "0::/")
        (folder / "net").mkdir()

    def add(
        self,
        pid: int,
        parent: int,
        *,
        start: int,
        group: str = "0::/",
        environ: str = "",
        port: int | None = None,
        hidden: bool = False,
    ) -> None:
        """Add a process; `hidden` is one whose sockets another user may not see."""
        place = self.folder / str(pid)
        self._group(place, group)
        fields = ["S", str(parent), *["0"] * 17, str(start), "0"]
        (place / "stat").write_text(f"{pid} (a ) name) {' '.join(fields)}\n")
        (place / "environ").write_bytes(environ.replace(" ", "\0").encode())
        if port is not None:
            self._tables.append(f"0: 00000000:{port:04X} 00000000:0000 0A 0 0 0 0 0 {port}")
            (self.folder / "net" / "tcp").write_text("\n".join(self._tables) + "\n")
        if not hidden:
            (place / "fd").mkdir()
            if port is not None:
                (place / "fd" / "3").symlink_to(f"socket:[{port}]")

    @property
    def visitors(self) -> set[int]:
        return set(self.container.visitors())

    @property
    def ports(self) -> dict[int, int | None]:
        return dict(self.container.Listeners().pids)

    @staticmethod
    def _group(place: Path, group: str) -> None:
        place.mkdir()
        (place / "cgroup").write_text(group + "\n")


def test_an_execd_process_and_its_children_are_visitors(proc: Proc):
    """`kubectl exec` starts processes without a parent in sight, later than the command."""
    proc.add(SHELL, 0, start=100)
    proc.add(NODE, SHELL, start=101, port=5000)
    proc.add(TOOL, 0, start=200)
    proc.add(CHILD, TOOL, start=201, port=6000)
    assert proc.visitors == {TOOL, CHILD}
    assert proc.ports == {5000: NODE}


def test_a_visitor_whose_shell_has_ended_is_known_by_its_mark(proc: Proc):
    """A tool that was left in the background becomes a child of process 1."""
    proc.add(SHELL, 0, start=100)
    proc.add(NODE, SHELL, start=101, port=5000)
    proc.add(TOOL, SHELL, start=200, port=6000, environ="A=b RIGEL_K8S_EXEC=1 C=d")
    assert proc.visitors == {TOOL}
    assert proc.ports == {5000: NODE}


def test_a_background_process_of_the_command_is_no_visitor(proc: Proc):
    """Whose parent has ended, process 1 inherits."""
    proc.add(SHELL, 0, start=100)
    proc.add(NODE, SHELL, start=300, port=5000, environ="OLD_RIGEL_K8S_EXEC=1")
    assert proc.visitors == set()
    assert proc.ports == {5000: NODE}


def test_the_command_of_a_shared_process_namespace_is_no_visitor(proc: Proc):
    """There process 1 is another container's; this container's command is its oldest process."""
    proc.add(1, 0, start=1, group="0::/pause")
    proc.add(NODE, 0, start=100, port=5000)
    proc.add(CHILD, 1, start=101, port=5001)
    proc.add(TOOL, 0, start=200, port=6000)
    proc.add(90, 0, start=300, group="0::/other", port=7000)
    assert proc.visitors == {TOOL}
    assert proc.ports == {5000: NODE, 5001: CHILD}


def test_hidden_ports_of_the_command_count_and_a_visitors_do_not(proc: Proc):
    """Sockets of another user have no owner in sight; a port that a visitor has is not theirs."""
    proc.add(SHELL, 0, start=100)
    proc.add(NODE, SHELL, start=101, port=5000, hidden=True)
    proc.add(TOOL, 0, start=200, port=6000)
    assert proc.ports == {5000: None}


def test_a_hidden_visitor_makes_nobodys_port_ours(proc: Proc):
    """Other pods' ports are in sight too, under host networking."""
    proc.add(SHELL, 0, start=100)
    proc.add(TOOL, 0, start=200, port=6000, hidden=True)
    assert proc.ports == {}


def test_a_process_that_ends_meanwhile_is_left_out(proc: Proc):
    """/proc shows no parent of it any more."""
    proc.add(SHELL, 0, start=100)
    proc.add(TOOL, SHELL, start=200)
    (proc.folder / str(TOOL) / "stat").unlink()
    assert proc.visitors == set()


def test_a_mark_of_the_containers_life(proc: Proc):
    """It changes when the container starts again, and with nothing else."""
    proc.add(SHELL, 0, start=100)
    first = proc.container.started()
    proc.add(NODE, SHELL, start=101)
    assert proc.container.started() == first
    (proc.folder / "1" / "stat").write_text(f"1 (sh) S 0 {'0 ' * 17}555 0\n")
    assert proc.container.started() != first


@contextmanager
def listening() -> Iterator[tuple[int, int]]:
    """A process of its own that listens; its id and its port."""
    text = "import socket,sys; s=socket.create_server(('127.0.0.1', 0))\n"
    text += "print(s.getsockname()[1], flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        yield process.pid, int(process.stdout.readline())
        process.communicate()


@pytest.mark.programs
def test_real_processes(script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch):
    """The kernel's own /proc is read as the files above are."""
    container = script("container")
    monkeypatch.setattr(container, "visitors", set)  # these tests may run by `docker exec`
    with listening() as (pid, port):
        assert pid in container.processes()
        assert container.Listeners().pids[port] == pid
        assert "-c import socket" in container.command(pid)
    assert port not in container.Listeners().pids
    assert container.command(pid) == ""
